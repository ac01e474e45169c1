"""First step of the locator: the part of a scan where the port can be, thinned, without stray points, with normals.

Everything after this step works in the *prior frame*: origin and axes of the expected port pose. There the port is at
most a few centimetres and degrees away from the identity, whatever the scanner's mounting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from perception.errors import EmptyScanError
from perception.estimate import Prior
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.scan import Cloud

THIN_M = 0.0012
BEFORE_M = 0.1
"""How far before the port the scan is kept: a plug's handle tells an occupied inlet from a hidden one."""
NEIGHBOURS = 20
MOST_POINTS = 200_000
"""Of more, every second, third and so on is kept: a sweep that went slowly takes no longer to locate in."""
_DENSITY_CELL_M = 0.0025
_STRAY_SHARE = 0.15
"""A point is a stray when its surroundings hold less than this share of what surface points have around them."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The cropped scan in the prior frame."""

    points: Array
    """(N, 3) every point that is left, in the order of the scan."""
    origins: Array
    """(N, 3) where the laser stood for each; a good guess where the scan does not say."""
    thin_points: Array
    """(M, 3) the same surface, thinned to ``THIN_M``."""
    thin_normals: Array
    """(M, 3) unit normals towards the sensor; zero where undefined."""
    sweep_direction: Array
    """(3,) unit vector of the sweep, along which speed errors stretch the scan."""
    sweep_middle: Array
    """(3,) where the laser stood at mid-sweep."""


def crop(cloud: Cloud, model: PortModel, prior: Prior, threads: int = 2) -> Scene:
    """Crops to where ``prior`` allows any part of ``model`` to be. Raises EmptyScanError when hardly one is left."""
    T_prior_ref = prior.T_ref_port.inverse()
    points = T_prior_ref.apply(cloud.points)
    inside = _inside(points, model, prior)
    points = points[inside]
    if len(points) < 100:
        raise EmptyScanError(f"only {len(points)} scan points lie where the prior expects the port")
    origins = T_prior_ref.apply(_laser_origins(cloud, inside))
    dense = np.flatnonzero(_without_strays(points))
    dense = dense[:: 1 + len(dense) // MOST_POINTS]
    points, origins = points[dense], origins[dense]
    if len(points) < 100:
        raise EmptyScanError("the scan has only stray points where the prior expects the port")
    thin, normals = _thinned(points, origins, threads)
    direction, middle = _sweep(cloud, T_prior_ref)
    return Scene(points, origins, thin, normals, direction, middle)


def _inside(points: Array, model: PortModel, prior: Prior) -> NDArray[np.bool_]:
    low, high = model.size
    radius = float(np.hypot(*np.maximum(np.abs(low[:2]), np.abs(high[:2]))))
    swing_xy = radius * np.sin(prior.roll_rad) * 0.6
    swing_z = radius * np.sin(prior.tilt_rad)
    side = prior.lateral_m + swing_xy + 0.004
    z_low, z_high = low[2] - prior.along_m - swing_z - 0.004, high[2] + prior.along_m + swing_z + BEFORE_M
    return np.asarray(
        (points[:, 0] > low[0] - side)
        & (points[:, 0] < high[0] + side)
        & (points[:, 1] > low[1] - side)
        & (points[:, 1] < high[1] + side)
        & (points[:, 2] > z_low)
        & (points[:, 2] < z_high)
    )


def _laser_origins(cloud: Cloud, inside: NDArray[np.bool_]) -> Array:
    """Where the laser stood. A bare file is taken for a sweep along y with the laser at x = z = 0."""
    if cloud.origins is not None:
        return cloud.origins[inside]
    origins = np.zeros((int(inside.sum()), 3))
    origins[:, 1] = cloud.points[inside, 1]
    return origins


def _without_strays(points: Array) -> NDArray[np.bool_]:
    cell = np.floor((points - points.min(axis=0)) / _DENSITY_CELL_M).astype(np.int64)
    shape = cell.max(axis=0) + 1
    flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    counts = np.bincount(flat, minlength=int(shape.prod())).reshape(shape).astype(np.float32)
    around = uniform_filter(counts, 3, mode="constant").reshape(-1)[flat] * 27.0
    return np.asarray(around >= max(4.0, _STRAY_SHARE * float(np.median(around))))


def _thinned(points: Array, origins: Array, threads: int) -> tuple[Array, Array]:
    # One thread for the grid: with more its result depends on timing.
    cloud = small_gicp.voxelgrid_sampling(points, THIN_M, 1)
    tree = small_gicp.KdTree(cloud, threads)
    small_gicp.estimate_normals(cloud, tree, NEIGHBOURS, threads)
    thin, normals = np.asarray(cloud.points())[:, :3], np.asarray(cloud.normals())[:, :3].copy()
    # The laser moves little within the port: one origin for each point's neighbourhood would change no sign.
    towards = np.median(origins, axis=0) - thin
    normals[np.einsum("ij,ij->i", normals, towards) < 0] *= -1.0
    return np.ascontiguousarray(thin), normals


def _sweep(cloud: Cloud, T_prior_ref: Pose) -> tuple[Array, Array]:
    """Direction of the sweep and where the laser stood in its middle, both in the prior frame."""
    if cloud.origins is None:
        return T_prior_ref.rotate(np.array([0.0, 1.0, 0.0])), T_prior_ref.apply(np.zeros(3))
    origins = cloud.origins[:: max(1, len(cloud) // 2000)]
    middle = origins.mean(axis=0)
    direction: Array = np.linalg.svd(origins - middle, full_matrices=False)[2][0]
    return T_prior_ref.rotate(direction), T_prior_ref.apply(middle)
