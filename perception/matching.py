"""Which surface of the model a scan point lies on, and the equations that this gives for the pose.

A point is matched by place and by the direction that the scan's surface faces there, so that a point on the rim near
its edge stays with the rim. Its distance to the matched plane is one equation; what edges add is in ``edges``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray

from perception.geometry import Array, Pose
from perception.port_model import FACING_M, PortModel

MIN_COSINE = 0.7
MIN_INCIDENCE = 0.05
"""Walls that the laser grazes at less than this show hardly anything but mixed pixels."""
_REACH_M = 0.003
_NEIGHBOURS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Scan points near the port with the directions that their surroundings face; prior frame."""

    points: Array
    normals: Array
    origins: Array

    def at_most(self, count: int) -> Measured:
        """About ``count`` of them, evenly, or all where there are fewer."""
        step = max(1, len(self.points) // count)
        return Measured(self.points[::step], self.normals[::step], self.origins[::step])


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Matched points in the port frame; N rows."""

    local: Array
    index: NDArray[np.int64]
    """(N,) sample of the model."""
    normal: Array
    """(N, 3) of that sample."""
    distance: Array
    """(N,) signed distance to the sample's plane."""
    kept: NDArray[np.int64]
    """(N,) numbers of the measured points."""
    ray: Array
    """(N, 3) from the point to where the laser stood."""
    incidence: Array
    """(N,) cosine between that ray and the surface's normal."""


def measure(points: Array, origins: Array, threads: int) -> Measured:
    """Estimates which way the surface faces at each point, from its neighbours."""
    cloud = small_gicp.PointCloud(points)
    small_gicp.estimate_normals(cloud, small_gicp.KdTree(cloud, threads), _NEIGHBOURS, threads)
    normals: Array = np.asarray(cloud.normals())[:, :3].copy()
    normals[np.einsum("ij,ij->i", normals, origins - points) < 0] *= -1.0
    return Measured(points, normals, origins)


def match(pose: Pose, measured: Measured, model: PortModel, threads: int) -> Matches:
    """Matches the points under T_prior_port = ``pose``; points without a surface in reach are left out."""
    surface = model.surface
    inverse = pose.inverse()
    local, facing = inverse.apply(measured.points), inverse.rotate(measured.normals)
    keys = np.hstack([local, FACING_M * facing])
    index = np.asarray(model.tree.query(keys, distance_upper_bound=_REACH_M, workers=threads)[1])
    kept = np.flatnonzero(index < len(surface))
    local, facing, index = local[kept], facing[kept], index[kept]
    normal = surface.normals[index]
    ray = inverse.apply(measured.origins[kept]) - local
    incidence = np.einsum("ij,ij->i", ray, normal) / np.linalg.norm(ray, axis=1)
    good = (np.einsum("ij,ij->i", facing, normal) > MIN_COSINE) & (incidence > MIN_INCIDENCE)
    local, index, normal, ray = local[good], index[good], normal[good], ray[good]
    distance = np.einsum("ij,ij->i", local - surface.points[index], normal)
    return Matches(local, index, normal, distance, kept[good], ray, incidence[good])
