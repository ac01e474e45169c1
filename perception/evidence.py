"""What speaks for and against a pose: how much of the visible port has scan points on it, and what contradicts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.crop import Scene
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.relief import flat_weights

ON_SURFACE_M = 0.0015
SAMPLE_STEP = 17


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Shares between 0 and 1, of model surface weighted by how distinctive it is."""

    coverage: float
    """Share of the surface that the scanner could see with scan points on it."""
    violation: float
    """Share of the points within the port's outline that end inside its solid material."""

    @property
    def score(self) -> float:
        """One number to rank poses by."""
        return self.coverage - self.violation


def judge(pose: Pose, scene: Scene, model: PortModel, tree: cKDTree, threads: int = 2) -> Evidence:
    """The evidence for T_prior_port = ``pose``. ``tree`` holds the scene's thinned points."""
    surface, weights = model.surface, flat_weights(model.surface)
    chosen = slice(None, None, SAMPLE_STEP)
    points, normals, weight = surface.points[chosen], surface.normals[chosen], weights[chosen]
    sensor = pose.inverse().apply(np.median(scene.origins, axis=0))
    weight = weight * (np.einsum("ij,ij->i", sensor - points, normals) > 0)
    distance = tree.query(pose.apply(points), distance_upper_bound=ON_SURFACE_M, workers=threads)[0]
    covered = float((weight * np.isfinite(distance)).sum() / max(weight.sum(), 1e-9))
    local = pose.inverse().apply(scene.thin_points)
    return Evidence(covered, _violation(local, model))


def _violation(local: Array, model: PortModel) -> float:
    inside, gap = _behind_front(local, model)
    return float((gap > 0.002).sum() / max(int(inside.sum()), 1))


def _behind_front(local: Array, model: PortModel) -> tuple[NDArray[np.bool_], Array]:
    """Which points lie within the port's outline, and how far behind the deepest surface nearby those are."""
    cell = 0.002
    low, high = model.size
    shape = np.ceil((high[:2] - low[:2]) / cell).astype(int) + 1
    floor = np.full(shape, np.inf)
    at = np.floor((model.surface.points[:, :2] - low[:2]) / cell).astype(int)
    np.minimum.at(floor, (at[:, 0], at[:, 1]), model.surface.points[:, 2])
    where = np.floor((local[:, :2] - low[:2]) / cell).astype(int)
    inside = ((where >= 0) & (where < shape)).all(axis=1)
    where = np.clip(where, 0, shape - 1)
    inside &= np.isfinite(floor[where[:, 0], where[:, 1]]) & (local[:, 2] < 0.01)
    gap = np.where(inside, floor[where[:, 0], where[:, 1]] - local[:, 2], 0.0)
    return inside, gap
