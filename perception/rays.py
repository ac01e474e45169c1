"""Place across the axis and roll by the rays themselves: what the laser would have met of the port, and what it met.

Each ray is cast at the CAD from where the laser stood. Where an edge lies elsewhere than the pose has it, rays end far
from where they should: walls, edges, wells and contacts all tell in the one currency, and no point has to be assigned
to a surface first. How far off a ray ends counts up to a cap, since mixed pixels and flying points are off by anything.

The cost jumps where a ray changes sides of an edge, so it has no useful derivative: a quadratic is fitted to it over a
few poses around, which are moved and drawn closer (a response surface; Box and Wilson, J. R. Stat. Soc. B 13, 1951).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array, Pose
from perception.port_model import PortModel

COARSE_M = (0.0008, 0.0004)
FINEST_M = (0.0001, 0.00005)
"""Distances between the poses compared, at ``LEVER_M`` for the roll, one after the other."""
FINE_SIGMAS, FINE_LEAST_M = 0.6, 0.00008
"""One in between, by the scan's noise (1 sigma): at it the curvature says how surely the pose is known."""
LEVER_M = 0.02
"""How far from the axis a roll counts as a shift."""
ACROSS = [0, 1, 5]
"""Place across the axis and roll among a motion's six numbers (translation, rotation vector)."""
ROUGHLY = 3000
"""Rays that are enough at ``COARSE_M``."""
_CAP = 4.0
"""Greatest cost of a ray, in halves of squared standard deviations; one that meets nothing costs half of it."""
_LEAST_COSINE = 0.25
"""Noise along a ray grows with its footprint on a slanted surface, up to this incidence."""
TELLS = 0.05
"""A ray whose cost differs by less between the poses tells them not apart."""
_FITS = 4
"""Quadratics fitted at each distance, at most."""
_ARRIVED = 0.5
"""A step shorter than this share of the distance needs no second one."""
_UNKNOWN_M = 0.002
"""Standard deviation of what nothing tells."""
_FLATTEST = 0.05
"""Least curvature taken for a step, as a share of the greatest: what is hardly determined moves little."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Measured points (N, 3) and where the laser stood for each (N, 3), one frame."""

    points: Array
    origins: Array

    def only(self, these: NDArray[np.int64]) -> Rays:
        """Some of them, by their numbers."""
        return Rays(self.points[these], self.origins[these])

    def at_most(self, most: int) -> Rays:
        """Not more than about ``most``, evenly."""
        step = 1 + len(self.points) // most
        return Rays(self.points[::step], self.origins[::step])


@dataclass(frozen=True, slots=True, eq=False)
class RayFit:
    """Where the rays have the port, and how surely: (x, y in metres, roll in radians), port frame."""

    T_prior_port: Pose
    information: Array
    """(3, 3) curvature of half the sum of squares in standard deviations; not always positive where little is seen."""
    pulls: Array
    """(N, 3) slope of each ray's cost; together they are next to 0."""
    local: Array
    """(N, 3) points of the rays that tell, port frame."""

    @property
    def least_known(self) -> float:
        """How surely what is least sure is known, in terms of the information about a shift, 1/m2."""
        lever = np.array([1.0, 1.0, LEVER_M])
        return float(np.linalg.eigvalsh(self.information / np.outer(lever, lever))[0])

    @property
    def known(self) -> Array:
        """The information (3, 3) without what is none: at least that of a pose within ``_UNKNOWN_M`` of here."""
        lever = np.array([1.0, 1.0, LEVER_M])
        values, axes = np.linalg.eigh(self.information / np.outer(lever, lever))
        least = np.maximum(values, _UNKNOWN_M**-2)
        return np.asarray((axes * least) @ axes.T * np.outer(lever, lever))


def telling(pose: Pose, rays: Rays, model: PortModel, scale_m: float, distance_m: float, threads: int = 1) -> Rays:
    """Those of the rays that tell poses near T_prior_port = ``pose`` apart: hardly any on the middle of a flat."""
    costs = _costs(pose, _CORNERS * distance_m, rays, model, scale_m, threads)
    return rays.only(np.flatnonzero(np.ptp(costs, axis=0) > TELLS))


def fit_rays(
    start: Pose, rays: Rays, model: PortModel, scale_m: float, distances_m: Sequence[float], threads: int = 1
) -> RayFit:
    """``start`` (T_prior_port) moved across its axis and rolled to where the rays fit best.

    :param scale_m: noise of the scan (1 sigma, squarely met).
    :param distances_m: how far apart the poses are that are compared, falling; each lets the pose move by six times as
        much at most.
    """
    rays = telling(start, rays, model, scale_m, distances_m[0], threads)
    share = _shares(start, rays, model, scale_m, distances_m[0], threads)
    pose, best = start, (np.inf, start)
    slopes, curvature, compared_at = np.zeros((3, 0)), np.zeros((3, 3)), 1.0
    for distance in distances_m:
        for _ in range(_FITS):
            costs = _costs(pose, _STENCIL * distance, rays, model, scale_m, threads) * share
            if costs[_MIDDLE].sum() > best[0]:  # too few rays change sides between these poses for a quadratic
                pose = best[1]
                break
            best = costs[_MIDDLE].sum(), pose
            slopes, curvature = _quadratic(costs)
            compared_at = distance
            step = _step(slopes.sum(axis=1), curvature)
            pose = pose @ _moved(step * distance)
            if np.abs(step).max() < _ARRIVED:
                break
    if (ray_costs(pose, rays, model, scale_m, threads) * share).sum() > best[0]:
        pose = best[1]
    per_radian = np.array([1.0, 1.0, LEVER_M]) / compared_at
    information = curvature * np.outer(per_radian, per_radian)
    return RayFit(pose, information, slopes.T * per_radian, pose.inverse().apply(rays.points))


def _moved(by: Array) -> Pose:
    """The motion by (x, y, roll at the lever), all metres."""
    return Pose.from_rotvec([0.0, 0.0, by[2] / LEVER_M], [by[0], by[1], 0.0])


def _costs(pose: Pose, around: Array, rays: Rays, model: PortModel, scale_m: float, threads: int) -> Array:
    """Cost (S, N) of each ray at each of the poses ``around`` (S, 3) metres from ``pose``."""
    return np.stack([ray_costs(pose @ _moved(by), rays, model, scale_m, threads) for by in around])


def ray_costs(pose: Pose, rays: Rays, model: PortModel, scale_m: float, threads: int = 1) -> Array:
    """Half the square of how far off each ray ends (N,), in standard deviations; not more than a cap.

    :param pose: T_prior_port, for rays in the prior's frame.
    :param scale_m: noise of the scan (1 sigma, squarely met).
    """
    T_port_prior = pose.inverse()
    origins = T_port_prior.apply(rays.origins)
    towards = T_port_prior.apply(rays.points) - origins
    length = np.linalg.norm(towards, axis=1)
    towards /= length[:, None]
    met = model.solid.cast(origins, towards, threads)
    off = (length - met.distance) * np.sqrt(np.clip(met.cosine, _LEAST_COSINE, 1.0)) / scale_m
    return np.where(met.tells, np.minimum(0.5 * off**2, _CAP), 0.5 * _CAP).astype(np.float32)


def _shares(pose: Pose, rays: Rays, model: PortModel, scale_m: float, distance: float, threads: int) -> Array:
    """Weight (N,) of each ray: all on one contact tell no more than where that contact may be."""
    beside = _costs(pose, _BESIDE * distance, rays, model, scale_m, threads)
    curved = (beside[1:].sum(axis=0) - 4.0 * beside[0]) / distance**2
    local = pose.inverse().apply(rays.points)
    return model.floating.shares(local[:, :2], np.ones(len(local)), curved)


def _stencil() -> Array:
    """(15, 3) poses compared: the middle, one step along each axis, the corners."""
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    moved = np.abs(grid).sum(axis=1)
    return np.asarray(grid[(moved <= 1) | (moved == 3)])


def _terms(at: Array) -> Array:
    """(S, 10) terms of a quadratic in three variables: 1, slopes, curvatures, mixed ones."""
    x, y, r = at.T
    return np.column_stack([np.ones(len(at)), x, y, r, 0.5 * x * x, 0.5 * y * y, 0.5 * r * r, x * y, x * r, y * r])


_STENCIL = _stencil()
_MIDDLE = len(_STENCIL) // 2
_NEXT = [np.flatnonzero((np.abs(_STENCIL).sum(axis=1) == 1) & (_STENCIL[:, k] != 0)) for k in range(3)]
_BESIDE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
_CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
_PSEUDO_INVERSE = np.linalg.pinv(_terms(_STENCIL))


def _quadratic(costs: Array) -> tuple[Array, Array]:
    """Slopes (3, N) of each ray's cost and the curvature (3, 3) of their sum, in units of the stencil."""
    slopes: Array = _PSEUDO_INVERSE[1:4] @ costs
    total = costs.sum(axis=1, dtype=np.float64)
    xy, xr, yr = _PSEUDO_INVERSE[7:] @ total
    # Not from the corners: so far away many a ray's cost is at its cap, and the sum's curvature is none.
    xx, yy, rr = (total[one].sum() - 2.0 * total[_MIDDLE] for one in _NEXT)
    return slopes, np.array([[xx, xy, xr], [xy, yy, yr], [xr, yr, rr]])


def _step(slope: Array, curvature: Array) -> Array:
    """Where the quadratic is least, in units of the stencil and not far beyond it."""
    values, axes = np.linalg.eigh(curvature)
    values = np.maximum(values, max(_FLATTEST * values[-1], 1e-9))
    return np.asarray(np.clip(-axes @ ((axes.T @ slope) / values), -1.5, 1.5))
