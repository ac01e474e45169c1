"""Several views of one port into one complete cloud, without a model: the problem that the paper starts from.

Views are registered one after another, each to the union of those before it, with the robust profile. Then all poses
are solved jointly, every view against every other at once, so that what the first steps got wrong is spread over all of
them instead of adding up. The first view's frame is that of the result. Millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from perception.errors import DegenerateCloudError, InputError
from perception.geometry import Array, Pose
from perception.published import clouds
from perception.published.dense import refine, subset
from perception.published.features import normals
from perception.published.kdtree import AdaptiveKDTree
from perception.published.pipeline import register
from perception.published.profiles import ROBUST
from perception.published.registration import trimmed_distance
from perception.published.target import PreparedTarget, prepare_target

_SETTINGS = replace(ROBUST, ranked_share=0.9)
"""Views differ less than scan and cut scan do: with a smaller share, a view slid along the panel ranks as high."""
_SHIFTS_MM = (0.0, -8.0, 8.0, -16.0, 16.0, -24.0, 24.0)
"""Along each of the two directions in which a mostly flat view slides: shadows' edges, which differ from view to view,
can pull keypoints that far."""
_CLEARLY = 0.7
_SHIFT_POINTS = 600
_SHIFT_GATES_MM = (6.0, 3.0, 1.5)
_GATES_MM = (3.0, 2.0, 1.5, 1.5, 1.0, 1.0, 1.0, 1.0)
_JOINT_POINTS = 1500
_NORMAL_NEIGHBOURS = 16
_MIN_OVERLAP = 0.3
_OVERLAP_MM = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """The poses that lay all views on the first one."""

    T_first_view: tuple[Pose, ...]
    """One for each view, translation in mm; the first is the identity."""
    sequential: tuple[Pose, ...]
    """The same before the joint step."""
    overlap: tuple[float, ...]
    """Share of each view's points that lie on another view."""

    def cloud(self, views: Sequence[Array]) -> Array:
        """All views (N_k, 3), mm, in the first one's frame."""
        return np.concatenate([pose.apply(view) for pose, view in zip(self.T_first_view, views, strict=True)])


def merge_views(views: Sequence[Array]) -> Merged:
    """Registers views (N_k, 3) of one port, mm, in any order that lets each overlap those before it.

    :raises InputError: fewer than two views.
    :raises DegenerateCloudError: a view does not fit to the others.
    """
    if len(views) < 2:
        raise InputError("one scan cannot be merged", remedy="Give two scans of one port, or more.")
    finite = [clouds.in_millimetres(view) for view in views]
    finite = [view[np.isfinite(view).all(axis=1)] for view in finite]
    sequential = _one_after_another(finite)
    joint = _jointly([subset(view, 3 * _JOINT_POINTS) for view in finite], sequential)
    overlap = _overlap([subset(view, _JOINT_POINTS) for view in finite], joint)
    for k, share in enumerate(overlap):
        if share < _MIN_OVERLAP:
            raise DegenerateCloudError(
                f"only {share:.0%} of scan {k + 1} fits to the others",
                remedy="Give scans of one port from viewpoints that overlap, without moving parts.",
            )
    return Merged(joint, sequential, overlap)


def _one_after_another(views: Sequence[Array]) -> tuple[Pose, ...]:
    poses = [Pose.identity()]
    together = views[0]
    for view in views[1:]:
        target = prepare_target(together, _SETTINGS)
        pose = _unslid(view, target, register(view, target, _SETTINGS).T_target_test)
        poses.append(pose)
        together = np.concatenate([together, pose.apply(view)])
    return tuple(poses)


def _unslid(view: Array, target: PreparedTarget, found: Pose) -> Pose:
    """The best of the pose found and of its neighbours along the surface, each refined point-to-plane."""
    points = subset(view, _SHIFT_POINTS)
    flat = np.linalg.svd(target.points - target.points.mean(axis=0), full_matrices=False)[2][:2]
    surface = target.points, target.normals, target.tree
    best, best_score = found, trimmed_distance(points, target.tree, found, _SETTINGS.ranked_share)
    for u in _SHIFTS_MM:
        for v in _SHIFTS_MM:
            beside = Pose(found.rotation, found.translation + np.array([u, v]) @ flat)
            pose = refine(points, *surface, beside, _SHIFT_GATES_MM)
            score = trimmed_distance(points, target.tree, pose, _SETTINGS.ranked_share)
            if score < _CLEARLY * best_score:  # a view that overlaps in part scores a little lower beside the truth
                best, best_score = pose, score
    return best


def _jointly(views: Sequence[Array], start: tuple[Pose, ...]) -> tuple[Pose, ...]:
    """Gauss-Newton on the point-to-plane distances of all pairs of views, the first view held."""
    trees = [cKDTree(view) for view in views]
    facing = [_normals(view) for view in views]
    poses = list(start)
    for gate in _GATES_MM:
        hessian, gradient = np.zeros((6 * len(views),) * 2), np.zeros(6 * len(views))
        for i, view in enumerate(views):
            for j in range(len(views)):
                if i != j:
                    _add_pair(view, views[j], facing[j], trees[j], poses, (i, j), gate, hessian, gradient)
        free = slice(6, None)
        damped = hessian[free, free] + 1e-6 * np.eye(6 * len(views) - 6)
        steps = np.linalg.lstsq(damped, gradient[free], rcond=1e-12)[0].reshape(-1, 6)
        for k, step in enumerate(steps, start=1):
            turn = Rotation.from_rotvec(step[3:]).as_matrix()
            poses[k] = Pose(turn @ poses[k].rotation, turn @ poses[k].translation + step[:3])
    return tuple(poses)


def _add_pair(
    view: Array,
    other: Array,
    facing: Array,
    tree: cKDTree,
    poses: Sequence[Pose],
    pair: tuple[int, int],
    gate: float,
    hessian: Array,
    gradient: Array,
) -> None:
    """Adds the normal equations of view i's points on view j's tangent planes, for motions about the common origin."""
    i, j = pair
    moved = poses[i].apply(subset(view, _JOINT_POINTS))
    distance, nearest = tree.query(poses[j].inverse().apply(moved), distance_upper_bound=gate)
    near = np.isfinite(distance)
    moved, nearest = moved[near], nearest[near]
    normal = poses[j].rotate(facing[nearest])
    residual = ((poses[j].apply(other[nearest]) - moved) * normal).sum(axis=1)
    jacobian = np.concatenate([normal, np.cross(moved, normal)], axis=1)
    weighted = jacobian / (1.0 + (residual / (gate / 3.0)) ** 2)[:, None]
    block, pull = weighted.T @ jacobian, weighted.T @ residual
    for a, b, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
        hessian[6 * a : 6 * a + 6, 6 * b : 6 * b + 6] += sign * block
    gradient[6 * i : 6 * i + 6] += pull
    gradient[6 * j : 6 * j + 6] -= pull


def _normals(view: Array) -> Array:
    _, _, neighbours = AdaptiveKDTree(view).knn_of_kept(_NORMAL_NEIGHBOURS)
    return normals(view, neighbours)


def _overlap(views: Sequence[Array], poses: Sequence[Pose]) -> tuple[float, ...]:
    placed = [pose.apply(view) for pose, view in zip(poses, views, strict=True)]
    shares = []
    for k, view in enumerate(placed):
        others = cKDTree(np.concatenate([other for n, other in enumerate(placed) if n != k]))
        shares.append(float((others.query(view)[0] < 2.0 * _OVERLAP_MM).mean()))
    return tuple(shares)
