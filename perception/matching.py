"""Which surface of the model a scan point lies on, and the equations that this gives for the pose.

A point is matched by place and by the direction that the scan's surface faces there, so that a point on the rim near
its edge stays with the rim. It gives up to two equations: its distance to the matched plane, and, where it lies beyond
the edge at which the matched surface ends, its distance to that edge. The second kind holds the port sideways and in
roll when it is seen straight on and shows no walls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray

from perception.geometry import Array, Pose
from perception.port_model import FACING_M, PortModel

MIN_COSINE = 0.7
_REACH_M = 0.003
_NEIGHBOURS = 16
_EDGE_SAMPLE_M = 0.0003
_EDGE_SLACK_M = 0.0002
"""Samples end on average this far from the edge itself."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Scan points near the port with the directions that their surroundings face; prior frame."""

    points: Array
    normals: Array
    origins: Array

    def every(self, step: int) -> Measured:
        """Each ``step``-th point."""
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
    outward: Array
    """(N, 3) unit direction from the surface's edge to the point, zero where it is not beyond one."""
    overhang: Array
    """(N,) how far beyond the edge the point lies, 0 where it does not."""
    kept: NDArray[np.int64]
    """(N,) numbers of the measured points."""


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
    good = (np.einsum("ij,ij->i", facing, normal) > MIN_COSINE) & (np.einsum("ij,ij->i", ray, normal) > 0)
    local, index, normal, kept = local[good], index[good], normal[good], kept[good]
    gap = local - surface.points[index]
    distance = np.einsum("ij,ij->i", gap, normal)
    aside = gap - distance[:, None] * normal
    length = np.linalg.norm(aside, axis=1)
    beyond = (surface.edge_m[index] < _EDGE_SAMPLE_M) & (length > _EDGE_SLACK_M)
    outward = np.where(beyond[:, None], aside / np.maximum(length, 1e-9)[:, None], 0.0)
    overhang = np.where(beyond, length - _EDGE_SLACK_M, 0.0)
    return Matches(local, index, normal, distance, outward, overhang, kept)
