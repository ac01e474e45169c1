"""Baseline 1: macro and micro structure with a virtual prior, multi-constraint registration.

Re-implemented from the description in the paper; the text of its reference [38] could not be read, so this is not
"the method of [38]". Macro structure: planes of scan and model, held together point-to-plane. Micro structure: points
of high surface variation, held to the nearest edge of the model. The virtual prior is the complete model cloud. No
denoising, no keypoints, no feedback. Millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from perception.evaluation.outcomes import Iterate, Outcome, Problem, Stopwatch, generator
from perception.evaluation.planes import Plane, find_planes
from perception.geometry import Array, Pose
from perception.published.features import SURFACE_VARIATION, eigen_features
from perception.published.kdtree import AdaptiveKDTree
from perception.published.registration import trimmed_distance
from perception.published.starts import start_poses

_EDGE_SHARE = 0.15
_GATES_MM = (40.0, 30.0, 20.0, 12.0, 8.0, 6.0, 4.0)
"""Gate of the micro structure, one for each round. The first ones are wide: narrow ones would make a strawman of this
baseline on partial scans."""
_INNER_STEPS = 5
_EDGE_WEIGHT = 1.0
_PLANE_ANGLE = np.cos(np.deg2rad(25.0))
_MAX_PLANE_POINTS = 1500
_MAX_EDGE_POINTS = 1200
_RANKED = 3000


@dataclass(frozen=True, slots=True, eq=False)
class _Sketch:
    """Macro and micro structure of one cloud."""

    points: Array
    planes: list[Plane]
    edges: Array
    """(n, 3) points of high surface variation."""


def _sketch(points: Array, rng: np.random.Generator) -> _Sketch:
    _, _, neighbours = AdaptiveKDTree(points).knn_of_kept(40)
    s = eigen_features(points, neighbours)[:, SURFACE_VARIATION]
    return _Sketch(points, find_planes(points, rng), points[s >= np.quantile(s, 1.0 - _EDGE_SHARE)])


class SketchMacroMicroBaseline:
    """Prepared for one target (M, 3). Starts from identity and from its own macro pose, keeps what fits better."""

    def __init__(self, target: Array, rng: np.random.Generator, *, many_starts: bool = False) -> None:
        self._sketch = _sketch(target, rng)
        self._tree, self._edge_tree = cKDTree(target), cKDTree(self._sketch.edges)
        self._many_starts = many_starts

    def __call__(self, problem: Problem) -> Outcome:
        """One iterate a round; a round is five Gauss-Newton steps from each start that is still in the race."""
        watch = Stopwatch(process_time)
        scan = _sketch(problem.test, generator(problem))
        ranked = scan.points[:: max(1, len(scan.points) // _RANKED)]
        poses = [Pose.identity(), self._macro_pose(scan)]
        if self._many_starts:
            poses += self._best_of_many(scan, ranked)
        iterates = []
        for k in range(problem.rounds):
            gate = _GATES_MM[min(k, len(_GATES_MM) - 1)]
            poses = [self._advance(scan, pose, gate, _INNER_STEPS) for pose in poses]
            best = min(poses, key=lambda pose: trimmed_distance(ranked, self._tree, pose))
            iterates.append(Iterate(best, None, watch.lap()))
        return tuple(iterates)

    def _best_of_many(self, scan: _Sketch, ranked: Array) -> list[Pose]:
        """The four best of the start poses that the robust profile tries too, after two steps each."""
        starts = start_poses(scan.points, self._sketch.points, Pose.identity())[1:]
        moved = [self._advance(scan, pose, _GATES_MM[0], 2) for pose in starts]
        return sorted(moved, key=lambda pose: trimmed_distance(ranked[::5], self._tree, pose))[:4]

    def _macro_pose(self, scan: _Sketch) -> Pose:
        """Lays the scan's dominant plane on the model's, and its centre on the model's."""
        centre_scan, centre_model = scan.points.mean(axis=0), self._sketch.points.mean(axis=0)
        if not scan.planes or not self._sketch.planes:
            return Pose(np.eye(3), centre_model - centre_scan)
        a, b = scan.planes[0].normal, self._sketch.planes[0].normal
        b = b if a @ b >= 0 else -b
        rotation = Rotation.align_vectors([b], [a])[0].as_matrix()
        return Pose(rotation, centre_model - rotation @ centre_scan)

    def _advance(self, scan: _Sketch, pose: Pose, gate: float, steps: int) -> Pose:
        for _ in range(steps):
            macro, micro = self._macro(scan, pose), self._micro(scan, pose, gate)
            pose = _step(pose, macro, micro, max(1.0, gate / 6.0))
        return pose

    def _macro(self, scan: _Sketch, pose: Pose) -> list[tuple[Array, Array, Array]]:
        """(moved points, normals, residuals) of each scan plane that has a plane of the model to go with."""
        terms = []
        for plane in scan.planes:
            partner = self._partner(plane, scan, pose)
            if partner is None:
                continue
            sparse = plane.members[:: max(1, len(plane.members) // (_MAX_PLANE_POINTS // 4))]
            moved = pose.apply(scan.points[sparse])
            normals = np.broadcast_to(partner.normal, moved.shape)
            terms.append((moved, normals, partner.offset - moved @ partner.normal))
        return terms

    def _partner(self, plane: Plane, scan: _Sketch, pose: Pose) -> Plane | None:
        """The model's plane within 25 degrees that lies closest."""
        normal = pose.rotation @ plane.normal
        centre = pose.apply(scan.points[plane.members].mean(axis=0))
        alike = [p for p in self._sketch.planes if abs(p.normal @ normal) > _PLANE_ANGLE]
        return min(alike, key=lambda p: abs(p.normal @ centre - p.offset), default=None)

    def _micro(self, scan: _Sketch, pose: Pose, gate: float) -> tuple[Array, Array, Array]:
        """(moved edge points, vectors to the nearest model edge, weights)."""
        moved = pose.apply(scan.edges[:: max(1, len(scan.edges) // _MAX_EDGE_POINTS)])
        distance, nearest = self._edge_tree.query(moved, distance_upper_bound=gate)
        near = np.isfinite(distance)
        weight = _EDGE_WEIGHT / (1.0 + (distance[near] / (gate / 3.0)) ** 2)
        return moved[near], self._sketch.edges[nearest[near]] - moved[near], weight


def _step(
    pose: Pose,
    macro: Sequence[tuple[Array, Array, Array]],
    micro: tuple[Array, Array, Array],
    plane_scale: float,
) -> Pose:
    """One joint Gauss-Newton step about the moved points' centre."""
    moved, gap, weight = micro
    everything = [m for m, _, _ in macro] + [moved]
    centre = np.concatenate(everything).mean(axis=0) if sum(map(len, everything)) else np.zeros(3)
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    for points, normals, residual in macro:
        jacobian = np.concatenate([normals, np.cross(points - centre, normals)], axis=1)
        robust = 1.0 / (1.0 + (residual / plane_scale) ** 2)
        hessian += (jacobian * robust[:, None]).T @ jacobian
        gradient += (jacobian * robust[:, None]).T @ residual
    for axis in np.eye(3):
        jacobian = np.concatenate([np.broadcast_to(axis, moved.shape), np.cross(moved - centre, axis)], axis=1)
        hessian += (jacobian * weight[:, None]).T @ jacobian
        gradient += (jacobian * weight[:, None]).T @ (gap @ axis)
    step = np.linalg.lstsq(hessian + 1e-6 * np.eye(6), gradient, rcond=1e-12)[0]
    turn = Rotation.from_rotvec(step[3:]).as_matrix()
    return Pose(turn @ pose.rotation, turn @ (pose.translation - centre) + centre + step[:3])
