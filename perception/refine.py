"""Final pose: iteratively reweighted point-to-plane registration of every point near the port against the CAD.

The scale of the weights follows the scan's own noise. Points near edges count less, since a laser spot there mixes two
surfaces, and so do points whose nearest surface the sensor could not have seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import small_gicp
from scipy.spatial import cKDTree

from perception.crop import Scene
from perception.errors import DegenerateCloudError
from perception.geometry import Array, Pose
from perception.port_model import PortModel

ROUNDS = 12
_REACH_M = 0.003
_MIN_SCALE_M = 0.00003
_TUKEY = 4.0
"""Points further off than this many robust standard deviations have no weight."""
_FIRST_GATE_M = 0.0015
_GATE_SHRINK = 0.75
_NEIGHBOURS = 16
_MIN_COSINE = 0.7
_EDGE_SIGMAS = 2.5
"""A point nearer to an edge than this many standard deviations may belong to either side."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The final pose and the equations that gave it."""

    T_prior_port: Pose
    jacobian: Array
    """(N, 6) of the used points' distances by a motion in the port frame: translation (m), rotation vector (rad)."""
    distance: Array
    """(N,) signed distances to the model surface, metres."""
    weight: Array
    """(N,) weights, 0 to 1."""
    local: Array
    """(N, 3) the used points in the port frame."""
    scale_m: float
    """Robust standard deviation of the distances."""

    @property
    def rms_m(self) -> float:
        """Weighted root mean square distance."""
        return float(np.sqrt((self.weight * self.distance**2).sum() / max(self.weight.sum(), 1e-12)))


def refine(start: Pose, scene: Scene, model: PortModel, *, rounds: int = ROUNDS, threads: int = 2) -> Refined:
    """Refines ``start`` (T_prior_port). Raises DegenerateCloudError when the points near it do not fix a pose."""
    surface = model.surface
    tree = model.tree
    pose, scale = start, 0.0005
    near = model.nearest.lookup(pose.inverse().apply(scene.points)) < model.nearest.none
    points, origins = scene.points[near], scene.origins[near]
    if len(points) < 50:
        raise DegenerateCloudError("hardly any scan point lies near the port's surface")
    measured = _normals(points, origins, threads)
    result: Refined | None = None
    for round_ in range(rounds):
        inverse = pose.inverse()
        local = inverse.apply(points)
        index = _nearest(tree, local, threads)
        valid = index < len(surface)
        local, index = local[valid], index[valid]
        n = surface.normals[index]
        distance = np.einsum("ij,ij->i", local - surface.points[index], n)
        usable = (np.einsum("ij,ij->i", inverse.apply(origins[valid]) - local, n) > 0) & (
            np.einsum("ij,ij->i", inverse.rotate(measured[valid]), n) > _MIN_COSINE
        )
        scale = _robust_scale(distance[usable], previous=scale)
        base = usable * np.clip(surface.edge_m[index] / (_EDGE_SIGMAS * scale) - 0.5, 0.0, 1.0)
        gate = max(_TUKEY * scale, _FIRST_GATE_M * _GATE_SHRINK**round_)
        u = distance / gate
        weight = np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0) * base
        jacobian = np.concatenate([n, np.cross(local, n)], axis=1)
        result = Refined(pose, jacobian, distance, weight, local, scale)
        step = _step(result)
        pose = _moved(pose, step)
        if gate <= _TUKEY * scale and np.linalg.norm(step[:3]) < 1e-6 and np.linalg.norm(step[3:]) < 1e-5:
            break
    assert result is not None
    return Refined(pose, result.jacobian, result.distance, result.weight, result.local, result.scale_m)


def _normals(points: Array, origins: Array, threads: int) -> Array:
    cloud = small_gicp.PointCloud(points)
    small_gicp.estimate_normals(cloud, small_gicp.KdTree(cloud, threads), _NEIGHBOURS, threads)
    normals: Array = np.asarray(cloud.normals())[:, :3].copy()
    normals[np.einsum("ij,ij->i", normals, origins - points) < 0] *= -1.0
    return normals


def _nearest(tree: cKDTree, local: Array, threads: int) -> Array:
    return np.asarray(tree.query(local, distance_upper_bound=_REACH_M, workers=threads)[1])


def _robust_scale(distance: Array, previous: float) -> float:
    """Standard deviation from the median absolute distance of the points within reach of the previous scale."""
    close = np.abs(distance[np.abs(distance) < 5 * previous])
    if len(close) < 30:
        return previous
    # Not faster than a third for each round: a gate that closes at once traps the pose where it happens to be.
    return float(np.clip(1.4826 * np.median(close), max(_MIN_SCALE_M, 0.67 * previous), previous))


def _step(current: Refined) -> Array:
    weighted = current.jacobian * current.weight[:, None]
    information = weighted.T @ current.jacobian
    scaling = np.array([1.0] * 3 + [1 / 0.03] * 3)
    scaled = information * np.outer(scaling, scaling)
    values = np.linalg.eigvalsh(scaled)
    if values[0] < 1e-5 * max(values[-1], 1e-12):
        raise DegenerateCloudError("the points near the port leave its pose undetermined in at least one direction")
    gradient = -(weighted * current.distance[:, None]).sum(axis=0)
    return np.asarray(np.linalg.solve(scaled, gradient * scaling) * scaling)


def _moved(pose: Pose, step: Array) -> Pose:
    """``step`` brings the scan onto the model, so the model moves by its inverse."""
    bounded = step.copy()
    bounded[3:] *= min(1.0, 0.05 / max(float(np.linalg.norm(step[3:])), 1e-12))
    return pose @ Pose.from_rotvec(bounded[3:], bounded[:3]).inverse()
