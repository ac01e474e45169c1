"""Baseline 2: segmentation into curvature intervals, curvature and FPFH features, four-point sets.

Re-implemented from the description in the paper and the abstract of its reference [39] (Xu, Rao, Fan, Chen, IEEE
Access 2023), the four-point step that the paper leaves out included; not "the method of [39]". The coplanar test of
affine ratios in the four-point family is implied by the six-length test for rigid motion. As in that family, pairs of
equal length are found first and sets are made of two such pairs: four points drawn at once are hardly ever all right
where many matches are wrong. The best pose is fitted again to all matches that agree with it. No ICP. Millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

from perception.evaluation.outcomes import Iterate, Outcome, Problem, Stopwatch, generator
from perception.geometry import Array, Pose
from perception.published.features import SURFACE_VARIATION, eigen_features
from perception.published.kdtree import AdaptiveKDTree
from perception.published.kdtree_numpy import Indices
from perception.published.registration import kabsch

_VOXEL_MM = 3.0
_FPFH_RADIUS_MM = 25.0
_NORMAL_RADIUS_MM = 7.0
_INTERVALS = 4
_MATCHES = 3
_PAIRS_DRAWN = 100_000
_SETS = 50_000
_TRIED, _TRIED_POINTS = 200, 200
_VERIFIED = 40
_LENGTH_MM = 3.0
_REFIT_MM = 5.0
_REFITS = 3
_SHORTEST_MM = 15.0
_INLIER_MM = 3.0
_VIEWPOINT_MM = (0.0, 0.0, 420.0)
_registration: Any = o3d.pipelines.registration
_PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


@dataclass(frozen=True, slots=True, eq=False)
class _Described:
    """A thinned cloud with a 34-dimensional feature for each point."""

    points: Array
    features: Array
    curvature: Array


def fpfh_cloud(points: Array, *, radius: float = _FPFH_RADIUS_MM, max_nn: int = 200) -> tuple[Any, Any]:
    """A thinned Open3D cloud with normals towards the scanner, and its FPFH features."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(_VOXEL_MM)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=_NORMAL_RADIUS_MM, max_nn=30))
    cloud.orient_normals_towards_camera_location(np.array(_VIEWPOINT_MM))
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=radius, max_nn=max_nn)
    return cloud, _registration.compute_fpfh_feature(cloud, search)


def _described(points: Array) -> _Described:
    cloud, fpfh = fpfh_cloud(points)
    thinned = np.asarray(cloud.points)
    _, _, neighbours = AdaptiveKDTree(thinned).knn_of_kept(min(15, len(thinned)))
    curvature = eigen_features(thinned, neighbours)[:, SURFACE_VARIATION]
    histogram = np.asarray(fpfh.data).T
    features = np.concatenate([histogram, 300.0 * curvature[:, None]], axis=1)
    return _Described(thinned, features, curvature)


class FourPointBaseline:
    """Prepared for one target (M, 3). A global method: it uses no start pose."""

    def __init__(self, target: Array) -> None:
        self._model = _described(target)
        self._tree = cKDTree(self._model.points)
        self._bounds = np.quantile(self._model.curvature, np.arange(1, _INTERVALS) / _INTERVALS)

    def __call__(self, problem: Problem) -> Outcome:
        """One iterate a round: 50,000 four-point sets drawn, the 200 that agree best tried, 40 of them verified."""
        watch, rng = Stopwatch(process_time), generator(problem)
        scan = _described(problem.test)
        source, candidates = self._matches(scan)
        best, best_score, iterates = Pose.identity(), -1.0, []
        for _ in range(problem.rounds):
            for pose in self._promising(self._hypotheses(scan.points, source, candidates, rng), scan.points):
                score = self._score(pose, scan.points)
                if score > best_score:
                    best, best_score = pose, score
            for _ in range(_REFITS):
                pose = self._refitted(best, scan.points[source], self._model.points[candidates])
                score = self._score(pose, scan.points)
                if score <= best_score:
                    break
                best, best_score = pose, score
            iterates.append(Iterate(best, None, watch.lap()))
        return tuple(iterates)

    def _score(self, pose: Pose, points: Array) -> float:
        """Share of points (n, 3) near the model."""
        return float(np.isfinite(self._tree.query(pose.apply(points), distance_upper_bound=_INLIER_MM)[0]).mean())

    def _promising(self, poses: list[Pose], points: Array) -> list[Pose]:
        """The poses worth a full verification, by a glance at few of the points."""
        few = points[:: max(1, len(points) // _TRIED_POINTS)]
        return sorted(poses, key=lambda pose: -self._score(pose, few))[:_VERIFIED]

    def _refitted(self, pose: Pose, points: Array, partners: Array) -> Pose:
        """Fitted to the matches, points (n, 3) to the nearest of partners (n, 3, 3), that agree with ``pose``."""
        distance = np.linalg.norm(pose.apply(points)[:, None] - partners, axis=2)
        agreeing = np.flatnonzero(distance.min(axis=1, initial=np.inf) < _REFIT_MM)
        if len(agreeing) < 4:
            return pose
        rotation, translation = kabsch(
            points[agreeing][None], partners[agreeing, distance[agreeing].argmin(axis=1)][None]
        )
        return Pose(rotation[0], translation[0])

    def _matches(self, scan: _Described) -> tuple[Indices, Indices]:
        """Scan points of the upper intervals (n,) and, for each, its nearest model points in the same one (n, 3)."""
        own, other = np.digitize(scan.curvature, self._bounds), np.digitize(self._model.curvature, self._bounds)
        sources, partners = [], []
        for interval in range(_INTERVALS // 2, _INTERVALS):
            mine, theirs = np.flatnonzero(own == interval), np.flatnonzero(other == interval)
            if len(mine) == 0 or len(theirs) < _MATCHES:
                continue
            _, nearest = cKDTree(self._model.features[theirs]).query(scan.features[mine], _MATCHES)
            sources.append(mine)
            partners.append(theirs[nearest])
        if not sources:
            return np.zeros(0, dtype=np.int64), np.zeros((0, _MATCHES), dtype=np.int64)
        return np.concatenate(sources), np.concatenate(partners)

    def _hypotheses(self, points: Array, source: Indices, candidates: Indices, rng: np.random.Generator) -> list[Pose]:
        """Poses from four-point sets whose six edges have the same lengths in scan and model, best agreement first."""
        if len(source) < 4:
            return []
        pair = rng.integers(len(source), size=(_PAIRS_DRAWN, 2))
        partner = candidates[pair, rng.integers(_MATCHES, size=(_PAIRS_DRAWN, 2))]
        mine = np.linalg.norm(points[source[pair[:, 0]]] - points[source[pair[:, 1]]], axis=1)
        theirs = np.linalg.norm(self._model.points[partner[:, 0]] - self._model.points[partner[:, 1]], axis=1)
        alike = np.flatnonzero((np.abs(mine - theirs) < _LENGTH_MM) & (mine > _SHORTEST_MM))
        if len(alike) < 2:
            return []
        two = alike[rng.integers(len(alike), size=(_SETS, 2))]
        p = points[source[pair[two].reshape(-1, 4)]]
        q = self._model.points[partner[two].reshape(-1, 4)]
        length_p = np.linalg.norm(p[:, _PAIRS[:, 0]] - p[:, _PAIRS[:, 1]], axis=2)
        length_q = np.linalg.norm(q[:, _PAIRS[:, 0]] - q[:, _PAIRS[:, 1]], axis=2)
        worst = np.abs(length_p - length_q).max(axis=1)
        agreeing = np.flatnonzero((worst < _LENGTH_MM) & (length_p.min(axis=1) > _SHORTEST_MM))
        agreeing = agreeing[np.argsort(worst[agreeing], kind="stable")][:_TRIED]
        if len(agreeing) == 0:
            return []
        rotation, translation = kabsch(p[agreeing], q[agreeing])
        return [Pose(r, t) for r, t in zip(rotation, translation, strict=True)]
