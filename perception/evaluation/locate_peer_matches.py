"""Correspondences by FPFH for the peers that start from some: Open3D's features and matching, thinned by the prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from perception.estimate import Prior
from perception.evaluation.locate_peer_cloud import PeerProblem
from perception.geometry import Array

SCALES_M = ((0.002, 0.0, 0.016), (0.003, 0.006, 0.024))
"""(spacing, radius of normals, radius of features) of each try; radius 0 keeps the scan's own normals, which show
narrow steps. Noise hides these, and a noisy scan is found by the coarser features."""
FEWEST = 10
"""Pairs without which no peer is asked: Open3D's global registration fails on none."""
_NEIGHBOURS = 250
_SLACK_M = 0.006
_registration: Any = o3d.pipelines.registration
_hybrid: Any = o3d.geometry.KDTreeSearchParamHybrid


@dataclass(frozen=True, eq=False)
class Matches:
    """Pairs of points that look alike and that the prior allows."""

    source: Any
    """Open3D cloud of the CAD in the port's frame."""
    target: Any
    """Open3D cloud of the scan in the prior's frame."""
    pairs: NDArray[np.int32]
    """(N, 2) indices into both."""

    @property
    def as_vector(self) -> Any:
        """The pairs as Open3D takes them."""
        return o3d.utility.Vector2iVector(self.pairs)

    @property
    def points(self) -> tuple[Array, Array]:
        """(N, 3) points of the CAD and of the scan, pair by pair."""
        return np.asarray(self.source.points)[self.pairs[:, 0]], np.asarray(self.target.points)[self.pairs[:, 1]]


def matches(problem: PeerProblem) -> list[Matches]:
    """Of each scale many pairs, and the few of them that are each other's nearest; sets that are too small left out."""
    found = [one for scale in SCALES_M for one in _matches(problem, *scale)]
    return [one for one in found if len(one.pairs) >= FEWEST]


def _matches(problem: PeerProblem, spacing_m: float, normal_m: float, feature_m: float) -> list[Matches]:
    source, target = (_thinned(cloud, spacing_m, normal_m) for cloud in (problem.cad.seen, problem.clean))
    ours, theirs = (
        _registration.compute_fpfh_feature(cloud, _hybrid(feature_m, _NEIGHBOURS)) for cloud in (source, target)
    )
    # A port has many features alike and the scan shows much beside it: few right pairs are each other's nearest, and
    # of a noisy scan none. With the nearest of either direction there are enough, once the prior has ruled others out.
    forth = np.asarray(_registration.correspondences_from_features(ours, theirs))
    back = np.asarray(_registration.correspondences_from_features(theirs, ours))[:, ::-1]
    pairs, times = np.unique(np.vstack([forth, back]), axis=0, return_counts=True)
    allowed = _allowed(source, target, pairs, problem.prior)
    return [
        Matches(source, target, np.ascontiguousarray(pairs[allowed & (times >= least)], dtype=np.int32))
        for least in (1, 2)
    ]


def _thinned(cloud: Any, spacing_m: float, normal_m: float) -> Any:
    """At a spacing, with normals over a radius that noise matters little in, on the sides that they were on."""
    cloud = cloud.voxel_down_sample(spacing_m).normalize_normals()
    if not normal_m:
        return cloud
    before = np.asarray(cloud.normals).copy()
    cloud.estimate_normals(_hybrid(normal_m, 60))
    after = np.asarray(cloud.normals)
    flipped = (before * after).sum(axis=1) < 0.0
    cloud.normals = o3d.utility.Vector3dVector(np.where(flipped[:, None], -after, after))
    return cloud


def _allowed(source: Any, target: Any, pairs: NDArray[np.int64], prior: Prior) -> NDArray[np.bool_]:
    """(N,) whether some pose that the prior allows brings a pair together."""
    here, there = np.asarray(source.points)[pairs[:, 0]], np.asarray(target.points)[pairs[:, 1]]
    cosine = (np.asarray(source.normals)[pairs[:, 0]] * np.asarray(target.normals)[pairs[:, 1]]).sum(axis=1)
    off, arm = there - here, np.linalg.norm(here[:, :2], axis=1)
    return np.asarray(
        (cosine > np.cos(prior.tilt_rad + prior.roll_rad))
        & (np.linalg.norm(off[:, :2], axis=1) < prior.lateral_m + arm * np.sin(prior.roll_rad) + _SLACK_M)
        & (np.abs(off[:, 2]) < prior.along_m + arm * np.sin(prior.tilt_rad) + _SLACK_M)
    )
