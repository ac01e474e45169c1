"""Several scans of one port, registered to each other and to the port's model at once.

The model is one more view that is held still; every scan is drawn to it and to every other scan by point-to-plane
distances with Tukey's weights, all poses solved together (Gauss-Newton, gates shrinking). What one scan lacks to fix
its own pose, for a part of the port is hidden, the others lend it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Array, Pose, exp
from perception.port_model import PortModel

_THIN_M = 0.0015
_AROUND_M = 0.012
_GATES_M = (0.004, 0.004, *(0.002,) * 4, *(0.001,) * 6, *(0.0006,) * 4)
_MIN_COSINE = 0.7
_PAIR_SHARE = 0.5
"""Of the model's weight: each pair of views is met twice, once from either."""
_DAMPING = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class _Sheet:
    """Points with normals of one view in its own frame, or of the model."""

    points: Array
    normals: Array
    tree: cKDTree


def register_views(views: Sequence[Array], T_port_views: Sequence[Pose], model: PortModel) -> tuple[Pose, ...]:
    """T_port_view of each view, refined together.

    :param views: points (N_k, 3) of each view in its own frame, metres.
    :param T_port_views: first guesses, good to some millimetres and degrees.
    """
    poses = list(T_port_views)
    sheets = [_sheet(points, pose, model) for points, pose in zip(views, poses, strict=True)]
    surface = _Sheet(model.surface.points, model.surface.normals, cKDTree(model.surface.points))
    for gate in _GATES_M:
        poses = _step(sheets, poses, surface, gate)
    return tuple(poses)


def _sheet(points: Array, T_port_view: Pose, model: PortModel) -> _Sheet:
    """The part of a view that can belong to the port, thinned, with normals towards the outside of the vehicle."""
    local = T_port_view.apply(points)
    low, high = model.size
    inside = ((local > low - _AROUND_M) & (local < high + _AROUND_M)).all(axis=1)
    cloud = small_gicp.voxelgrid_sampling(points[inside], _THIN_M, 1)
    small_gicp.estimate_normals(cloud, small_gicp.KdTree(cloud), 15)
    thin, normals = np.asarray(cloud.points())[:, :3].copy(), np.asarray(cloud.normals())[:, :3].copy()
    outward = T_port_view.inverse().rotate(np.array([0.0, 0.0, 1.0]))
    normals[normals @ outward < 0] *= -1.0
    return _Sheet(thin, normals, cKDTree(thin))


def _step(sheets: list[_Sheet], poses: list[Pose], surface: _Sheet, gate: float) -> list[Pose]:
    """One Gauss-Newton step of all views."""
    size = 6 * len(sheets)
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    for i, sheet in enumerate(sheets):
        rows = slice(6 * i, 6 * i + 6)
        jacobian, distance, weight = _pairs(sheet, poses[i], surface, Pose.identity(), gate)
        hessian[rows, rows] += (jacobian * weight[:, None]).T @ jacobian
        gradient[rows] -= jacobian.T @ (weight * distance)
        for j, other in enumerate(sheets):
            if i == j:
                continue
            jacobian, distance, weight = _pairs(sheet, poses[i], other, poses[j], gate)
            columns = slice(6 * j, 6 * j + 6)
            block = _PAIR_SHARE * (jacobian * weight[:, None]).T @ jacobian
            pull = _PAIR_SHARE * jacobian.T @ (weight * distance)
            hessian[rows, rows] += block
            hessian[columns, columns] += block
            hessian[rows, columns] -= block
            hessian[columns, rows] -= block
            gradient[rows] -= pull
            gradient[columns] += pull
    scale = np.tile([1.0] * 3 + [0.03**2] * 3, len(sheets))
    step = np.asarray(np.linalg.solve(hessian + _DAMPING * np.diag(scale), gradient), dtype=np.float64).reshape(-1, 6)
    return [_moved(pose, one) for pose, one in zip(poses, step, strict=True)]


def _moved(pose: Pose, step: Array) -> Pose:
    """A pose moved by a small motion (translation, rotation vector) of the port frame."""
    return exp(step) @ pose


def _pairs(
    sheet: _Sheet, pose: Pose, other: _Sheet, T_port_other: Pose, gate: float
) -> tuple[Array, Array, NDArray[np.float64]]:
    """Jacobian (N, 6) of the view's motion in the port frame, distances and weights of its pairs with another sheet."""
    points, normals = pose.apply(sheet.points), pose.rotate(sheet.normals)
    distance, index = other.tree.query(T_port_other.inverse().apply(points), distance_upper_bound=2.0 * gate)
    near = np.isfinite(distance)
    points, normals, index = points[near], normals[near], index[near]
    n = T_port_other.rotate(other.normals[index])
    gap = points - T_port_other.apply(other.points[index])
    off = np.einsum("ij,ij->i", gap, n)
    weight = np.where(np.abs(off) < gate, (1.0 - (off / gate) ** 2) ** 2, 0.0)
    weight = np.where(np.einsum("ij,ij->i", normals, n) > _MIN_COSINE, weight, 0.0)
    return np.hstack([n, np.cross(points, n)]), off, weight
