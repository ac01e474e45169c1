"""Dense point-to-plane refinement (an extension): from the keypoints' degree and millimetre to hundredths of both.

Gauss-Newton on the distances of scan points to the target's tangent planes, with gates that shrink and Cauchy weights,
so that outliers and missing parts do not pull. Millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from perception.geometry import Array, Pose

GATES_SPACINGS = (8.0, 4.0, 2.0, 1.5)
MAX_POINTS = 3000
_ITERATIONS = 12
_CONVERGED_MM = 2e-4


def refine(points: Array, target: Array, normals: Array, tree: cKDTree, start: Pose, gates_mm: Sequence[float]) -> Pose:
    """T_target_test refined on points (n, 3). A gate within which fewer than 12 points lie ends the refinement."""
    pose = start
    for gate in gates_mm:
        for _ in range(_ITERATIONS):
            moved = pose.apply(points)
            distance, nearest = tree.query(moved, distance_upper_bound=gate)
            near = np.isfinite(distance)
            if near.sum() < 12:
                return pose
            step = _gauss_newton_step(moved[near], target[nearest[near]], normals[nearest[near]], gate / 3.0)
            centre = moved[near].mean(axis=0)
            turn = Rotation.from_rotvec(step[3:]).as_matrix()
            pose = Pose(turn @ pose.rotation, turn @ (pose.translation - centre) + centre + step[:3])
            if np.abs(step[:3]).max() < _CONVERGED_MM and np.abs(step[3:]).max() * 50.0 < _CONVERGED_MM:
                break
    return pose


def _gauss_newton_step(moved: Array, goal: Array, normal: Array, cauchy_mm: float) -> Array:
    """(6,) translation and rotation vector about the points' mean."""
    residual = ((goal - moved) * normal).sum(axis=1)
    weight = 1.0 / (1.0 + (residual / cauchy_mm) ** 2)
    jacobian = np.concatenate([normal, np.cross(moved - moved.mean(axis=0), normal)], axis=1)
    weighted = jacobian * weight[:, None]
    hessian = weighted.T @ jacobian
    hessian[np.diag_indices(6)] *= 1.0 + 1e-9  # a plane leaves directions open: do not move along them
    return np.asarray(np.linalg.lstsq(hessian, weighted.T @ residual, rcond=1e-10)[0])


def subset(points: Array, limit: int) -> Array:
    """Every n-th point, at most about ``limit`` of them: fixed, so that results repeat."""
    return points[:: max(1, -(-len(points) // limit))]
