"""Keypoints, equations (14) to (16)."""

import numpy as np
import pytest

from perception.errors import DegenerateCloudError
from perception.geometry import Pose
from perception.published.features import FeatureScale
from perception.published.keypoints import (
    KeypointSettings,
    average_linkage,
    extract_keypoints,
    select_salient,
    thin,
)

FLAT = FeatureScale(np.zeros(7), np.ones(7))


def brute_force(points, dist_min, floor):
    """Merge the closest pair of clusters, by average distance over all cross pairs, as the paper says it."""
    clusters = [[i] for i in range(len(points))]
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    while len(clusters) > floor:
        pairs = [
            (distance[np.ix_(a, b)].mean(), i, j) for i, a in enumerate(clusters) for j, b in enumerate(clusters[:i])
        ]
        closest, i, j = min(pairs)
        if closest >= dist_min:
            break
        clusters[j] += clusters.pop(i)
    return {frozenset(c) for c in clusters}


@pytest.mark.parametrize("dist_min", [0.0, 2.0, 5.0, 1e9])
@pytest.mark.parametrize("floor", [1, 7, 40])
def test_the_cut_equals_merging_pair_by_pair(dist_min, floor):
    points = np.random.default_rng(0).uniform(0, 15, (30, 3))
    labels = average_linkage(points, dist_min, floor)
    cut = {frozenset(np.flatnonzero(labels == c)) for c in range(labels.max() + 1)}
    assert cut == brute_force(points, dist_min, floor)


def test_the_cluster_floor_wins_over_the_threshold():
    points = np.random.default_rng(1).uniform(0, 1, (50, 3))
    assert average_linkage(points, 1e9, 12).max() + 1 == 12


def test_a_keypoint_is_the_centroid_of_its_cluster_and_carries_its_mean_features_and_size():
    points = np.array([[0, 0, 0], [1, 0, 0], [30, 0, 0], [30, 2, 0], [30, 1, 0], [90.0, 0, 0]])
    features = np.arange(42.0).reshape(6, 7)
    settings = KeypointSettings(mode="xyz", dist_min=5.0, min_clusters=1, min_size=2)
    found = extract_keypoints(points, features, settings, FLAT)
    order = np.argsort(found.points[:, 0])
    np.testing.assert_allclose(found.points[order], [[0.5, 0, 0], [30, 1, 0]])
    np.testing.assert_array_equal(found.sizes[order], [2, 3])
    np.testing.assert_allclose(found.features[order], [features[:2].mean(0), features[2:5].mean(0)])


def test_salient_points_are_those_of_largest_surface_variation():
    features = np.zeros((100, 7))
    features[:, 0] = np.random.default_rng(2).permutation(100)
    chosen = select_salient(features, 0.25)
    assert len(chosen) == 25
    assert features[chosen, 0].min() == 75


@pytest.mark.parametrize("mode", ["xyz", "salient", "joint", "feat"])
def test_keypoints_move_with_the_cloud(mode):
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 40, (400, 3))
    features = rng.normal(size=(400, 7))
    settings = KeypointSettings(mode=mode, dist_min=4.0 if mode in ("xyz", "salient") else 20.0, max_points=1000)
    pose = Pose.from_rotvec([0.4, -0.3, 1.0], [5.0, 6.0, -7.0])
    here = extract_keypoints(points, features, settings, FLAT)
    there = extract_keypoints(pose.apply(points), features, settings, FLAT)
    expected = pose.apply(here.points)
    gaps = np.linalg.norm(expected[:, None] - there.points[None], axis=2).min(axis=1)
    assert (gaps < 1e-6).mean() > 0.95


def test_thinning_is_repeatable_and_keeps_within_the_limit():
    points = np.random.default_rng(4).uniform(0, 100, (5000, 3))
    kept = thin(points, 700)
    assert 350 < len(kept) <= 700
    np.testing.assert_array_equal(kept, thin(points, 700))
    np.testing.assert_array_equal(thin(points[:600], 700), np.arange(600))


def test_clusters_that_are_all_too_small_are_refused():
    settings = KeypointSettings(mode="xyz", dist_min=0.1, min_size=3)
    with pytest.raises(DegenerateCloudError, match="cluster"):
        extract_keypoints(np.eye(3) * 50, np.zeros((3, 7)), settings, FLAT)
