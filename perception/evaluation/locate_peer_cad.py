"""The CAD as peers get it: dense samples to align against, and what a scan would show of it to find it by.

Of the CAD's visible surface a sweep shows a quarter: the walls of the sockets, which are most of it, face across the
laser. Features of a cloud with those walls match nothing in a scan.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

from perception.evaluation.locate_unit import NEIGHBOURS, VOXEL_M
from perception.geometry import Array
from perception.port_model import PortModel

_THINNED_M = 0.0015
_RAY_M = 0.0007
_CAMERA_RAD = float(np.deg2rad(20.0))
"""From the laser to the camera, which stands on either side of it: what it cannot see is in no scan."""
_LIFT_M = 0.0001
_AWAY_M = 0.3


@dataclass(frozen=True, eq=False)
class PeerCad:
    """Open3D clouds in the port's frame, with normals."""

    samples: Any
    """The model's samples of what can be seen from somewhere in front."""
    thinned: Any
    """The samples at ``_THINNED_M``."""
    seen: Any
    """What a laser and its camera see from straight in front, at ``VOXEL_M`` and with normals as a scan has them."""
    tree: cKDTree
    """Of the points of ``samples``."""


@lru_cache(maxsize=16)
def peer_cad(model: PortModel) -> PeerCad:
    """The clouds of a model; made once, like what each peer trains once for a model."""
    samples = cloud_of(model.surface.points, model.surface.normals)
    return PeerCad(
        samples, samples.voxel_down_sample(_THINNED_M).normalize_normals(), _seen(model), cKDTree(model.surface.points)
    )


def _seen(model: PortModel) -> Any:
    low, high = model.size
    x, y = np.meshgrid(np.arange(low[0], high[0], _RAY_M), np.arange(low[1], high[1], _RAY_M))
    starts = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high[2] + _LIFT_M)])
    depth = _cast(model, starts, np.array([0.0, 0.0, -1.0]))
    hit = np.isfinite(depth)
    points = starts[hit] - depth[hit, None] * np.array([0.0, 0.0, 1.0])
    lifted = points + np.array([0.0, 0.0, _LIFT_M])
    sides = (np.array([side * np.sin(_CAMERA_RAD), 0.0, np.cos(_CAMERA_RAD)]) for side in (-1.0, 1.0))
    open_to = np.any([np.isinf(_cast(model, lifted, side)) for side in sides], axis=0)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[open_to])).voxel_down_sample(VOXEL_M)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    cloud.orient_normals_towards_camera_location(np.array([0.0, 0.0, _AWAY_M]))
    return cloud


def _cast(model: PortModel, starts: Array, direction: Array) -> Array:
    """(N,) distances along one direction to the mesh; infinite where there is none."""
    return model.solid.cast(starts, np.broadcast_to(direction, starts.shape)).distance


def cloud_of(points: Array, normals: Array) -> Any:
    """An Open3D cloud."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud
