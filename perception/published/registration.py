"""Registration of keypoints by ICP and its loss, equation (17).

All lengths are in millimetres. ``T_target_test`` maps the test cloud onto the target: ``x_target = R x_test + t``.
Several starts run as one batch, so that many of them cost few calls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from perception.geometry import Array, Pose
from perception.published.kdtree_numpy import Indices


@dataclass(frozen=True, slots=True)
class IcpSettings:
    """When keypoint ICP stops and what it trusts."""

    max_iterations: int = 50
    """In each stage."""
    trims: tuple[float, ...] = (1.0, 0.8)
    """Share of the closest pairs that each stage uses; 1.0 is plain ICP. All pairs pull further, the best are truer."""
    tolerance: float = 1e-9
    """Relative change of the mean squared residual at which it has converged."""


@dataclass(frozen=True, slots=True, eq=False)
class IcpResult:
    """One start's outcome."""

    T_target_test: Pose
    """Translation in mm."""
    loss_mm2: float
    """Equation (17) over the pairs used: what the algorithm itself can see of its error."""
    iterations: int
    valid: bool
    """False if there were fewer than 4 pairs or they lie on a line: then the pose is the start."""


def keypoint_loss(test: Array, target: Array) -> float:
    """Equation (17): mean squared distance of corresponding points (A, 3), in mm^2."""
    return float(((test - target) ** 2).sum(axis=1).mean())


def kabsch(test: Array, target: Array) -> tuple[Array, Array]:
    """Least-squares rotations (B, 3, 3) and translations (B, 3) that take test points (B, n, 3) to target points.

    The determinant is +1 even where the points are planar or the best orthogonal matrix would be a reflection.
    """
    mean_test, mean_target = test.mean(axis=1, keepdims=True), target.mean(axis=1, keepdims=True)
    cross = np.swapaxes(test - mean_test, 1, 2) @ (target - mean_target)
    u, _, vt = np.linalg.svd(cross)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= sign[:, None]
    rotation = np.swapaxes(u @ vt, 1, 2)
    translation = mean_target[:, 0] - np.einsum("bij,bj->bi", rotation, mean_test[:, 0])
    return rotation, translation


def keypoint_icp(
    test: Array, target: cKDTree, starts: Sequence[Pose], settings: IcpSettings | None = None
) -> list[IcpResult]:
    """Closest-point ICP of test keypoints (m, 3) from each start, against a tree of the target's keypoints."""
    settings = settings or IcpSettings()
    goal = np.asarray(target.data)
    fewest = int(np.ceil(min(settings.trims) * len(test)))
    if fewest < 4 or len(goal) < 4 or _collinear(test) or _collinear(goal):
        return [IcpResult(start, float("inf"), 0, False) for start in starts]
    batch = _Batch(
        np.stack([start.rotation for start in starts]),
        np.stack([start.translation for start in starts]),
        np.full(len(starts), np.inf),
        np.zeros(len(starts), dtype=np.int64),
    )
    for trim in settings.trims:
        _run_stage(test, goal, target, batch, int(np.ceil(trim * len(test))), settings)
    return [
        IcpResult(Pose(rotation, translation), float(loss), int(iterations), True)
        for rotation, translation, loss, iterations in zip(
            batch.rotation, batch.translation, batch.loss, batch.iterations, strict=True
        )
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Batch:
    """The state of B starts; the arrays are written in place."""

    rotation: Array
    translation: Array
    loss: Array
    iterations: Indices


def _run_stage(test: Array, goal: Array, target: cKDTree, batch: _Batch, n_pairs: int, settings: IcpSettings) -> None:
    """Iterates each start until its loss no longer falls."""
    batch.loss[:] = np.inf
    active = np.arange(len(batch.loss))
    for _ in range(settings.max_iterations):
        moved = test @ np.swapaxes(batch.rotation[active], 1, 2) + batch.translation[active, None]
        distance, nearest = target.query(moved.reshape(-1, 3))
        distance, nearest = distance.reshape(moved.shape[:2]), nearest.reshape(moved.shape[:2])
        best = np.argpartition(distance, n_pairs - 1, axis=1)[:, :n_pairs]
        now = (np.take_along_axis(distance, best, axis=1) ** 2).mean(axis=1)  # (17)
        before, batch.loss[active] = batch.loss[active], now
        going = ~(before - now <= settings.tolerance * now)  # the first loss before is infinite
        active, best, nearest = active[going], best[going], nearest[going]
        if len(active) == 0:
            break
        pairs = np.take_along_axis(nearest, best, axis=1)
        batch.rotation[active], batch.translation[active] = kabsch(test[best], goal[pairs])
        batch.iterations[active] += 1


def trimmed_distance(points: Array, target: cKDTree, T_target_test: Pose, keep: float = 0.7) -> float:
    """Mean squared distance (mm^2) of the best ``keep`` share of points to their nearest target points.

    The score that ranks iterates and starts. It must be taken on one fixed set of points: on each round's own denoised
    cloud it would fall for nothing but removing points.
    """
    squared = np.asarray(target.query(T_target_test.apply(points))[0]) ** 2
    n = max(1, int(keep * len(squared)))
    return float(np.partition(squared, n - 1)[:n].mean())


def _collinear(points: Array) -> bool:
    if len(points) < 3:
        return True
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] <= 1e-6 * max(spread[0], 1e-12))
