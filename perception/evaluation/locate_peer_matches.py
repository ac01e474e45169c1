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

SCALES_M = ((0.002, 0.005, 0.016), (0.003, 0.006, 0.024))
"""(spacing, radius of normals, radius of features) of each try: a noisy scan is found at the coarser ones alone."""
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
    """One set for each scale that has enough of them."""
    found = [_matches(problem, *scale) for scale in SCALES_M]
    return [one for one in found if len(one.pairs) >= FEWEST]


def _matches(problem: PeerProblem, spacing_m: float, normal_m: float, feature_m: float) -> Matches:
    source, target = (_thinned(cloud, spacing_m, normal_m) for cloud in (problem.cad.seen, problem.clean))
    ours, theirs = (
        _registration.compute_fpfh_feature(cloud, _hybrid(feature_m, _NEIGHBOURS)) for cloud in (source, target)
    )
    # Few features are each other's nearest, as a port has many alike and the scan shows much beside it: nearest ones
    # of both directions are taken, and the prior rules most of the wrong ones out.
    forth = np.asarray(_registration.correspondences_from_features(ours, theirs))
    back = np.asarray(_registration.correspondences_from_features(theirs, ours))[:, ::-1]
    pairs = np.unique(np.vstack([forth, back]), axis=0)
    allowed = _allowed(*((np.asarray(c.points), np.asarray(c.normals)) for c in (source, target)), pairs, problem.prior)
    return Matches(source, target, np.ascontiguousarray(pairs[allowed], dtype=np.int32))


def _thinned(cloud: Any, spacing_m: float, normal_m: float) -> Any:
    """At a spacing, with normals over a radius that noise matters little in, on the sides that they were on."""
    cloud = cloud.voxel_down_sample(spacing_m)
    before = np.asarray(cloud.normals).copy()
    cloud.estimate_normals(_hybrid(normal_m, 60))
    after = np.asarray(cloud.normals)
    flipped = (before * after).sum(axis=1) < 0.0
    cloud.normals = o3d.utility.Vector3dVector(np.where(flipped[:, None], -after, after))
    return cloud


def _allowed(
    source: tuple[Array, Array], target: tuple[Array, Array], pairs: NDArray[np.int64], prior: Prior
) -> NDArray[np.bool_]:
    """(N,) whether some pose that the prior allows brings a pair together."""
    here, there = source[0][pairs[:, 0]], target[0][pairs[:, 1]]
    cosine = (source[1][pairs[:, 0]] * target[1][pairs[:, 1]]).sum(axis=1)
    off, arm = there - here, np.linalg.norm(here[:, :2], axis=1)
    return np.asarray(
        (cosine > np.cos(prior.tilt_rad + prior.roll_rad))
        & (np.linalg.norm(off[:, :2], axis=1) < prior.lateral_m + arm * np.sin(prior.roll_rad) + _SLACK_M)
        & (np.abs(off[:, 2]) < prior.along_m + arm * np.sin(prior.tilt_rad) + _SLACK_M)
    )
