"""Baseline 2: segmentation into curvature intervals, curvature and FPFH features, four-point sets.

Re-implemented from the description in the paper and the abstract of its reference [39] (Xu, Rao, Fan, Chen, IEEE
Access 2023), the four-point step that the paper leaves out included; not "the method of [39]". The coplanar test of
affine ratios in the four-point family is implied by the six-length test for rigid motion. No ICP. Millimetres.
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
_SETS = 50_000
_VERIFIED = 40
_LENGTH_MM = 5.0
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
        """One iterate a round; a round draws 50,000 four-point sets and verifies the 40 that agree best."""
        watch, rng = Stopwatch(process_time), generator(problem)
        scan = _described(problem.test)
        source, candidates = self._matches(scan)
        best, best_score, iterates = Pose.identity(), -1.0, []
        for _ in range(problem.rounds):
            for pose in self._hypotheses(scan.points, source, candidates, rng):
                distance = self._tree.query(pose.apply(scan.points), distance_upper_bound=_INLIER_MM)[0]
                score = float(np.isfinite(distance).mean())
                if score > best_score:
                    best, best_score = pose, score
            iterates.append(Iterate(best, None, watch.lap()))
        return tuple(iterates)

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
        pick = rng.integers(len(source), size=(_SETS, 4))
        p = points[source[pick]]
        q = self._model.points[candidates[pick, rng.integers(_MATCHES, size=(_SETS, 4))]]
        length_p = np.linalg.norm(p[:, _PAIRS[:, 0]] - p[:, _PAIRS[:, 1]], axis=2)
        length_q = np.linalg.norm(q[:, _PAIRS[:, 0]] - q[:, _PAIRS[:, 1]], axis=2)
        worst = np.abs(length_p - length_q).max(axis=1)
        agreeing = np.flatnonzero((worst < _LENGTH_MM) & (length_p.min(axis=1) > _SHORTEST_MM))
        agreeing = agreeing[np.argsort(worst[agreeing], kind="stable")][:_VERIFIED]
        if len(agreeing) == 0:
            return []
        rotation, translation = kabsch(p[agreeing], q[agreeing])
        return [Pose(r, t) for r, t in zip(rotation, translation, strict=True)]
