"""Eigen-features, equations (9) to (13): identities and the three pure shapes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.published.features import FEATURE_NAMES, FeatureScale, covariances, eigen_features, normals
from perception.published.kdtree import AdaptiveKDTree

S, L, C, N, Z, Q, P = range(7)


def features_of(points, k=40):
    _, _, neighbours = AdaptiveKDTree(points).knn_of_kept(k)
    return eigen_features(points, neighbours)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**20), st.tuples(*[st.floats(0.0, 50.0)] * 3))
def test_the_identities_hold_for_any_neighbourhood(seed, scale):
    points = np.random.default_rng(seed).normal(0, 1, (60, 3)) * scale
    f = features_of(points, 20)
    np.testing.assert_allclose(f[:, P], 1 - f[:, N], atol=1e-9)
    np.testing.assert_allclose(f[:, P], f[:, L] + f[:, C], atol=1e-9)
    assert (f[:, S] >= 0).all()
    assert (f[:, S] <= 1 / 3 + 1e-9).all()
    assert (f[:, Z] >= -1e-9).all()
    assert (f[:, Z] <= np.log(3) + 1e-9).all()
    assert (f[:, Q] >= 0).all()
    assert (f[:, Q] <= 1 / 3 + 1e-9).all()


def test_covariances_are_those_of_numpy_and_positive_semidefinite():
    points = np.random.default_rng(0).normal(0, [1, 2, 3], (50, 3))
    neighbours = np.array([np.arange(10), np.arange(30, 40)])
    c = covariances(points, neighbours)
    np.testing.assert_allclose(c[1], np.cov(points[30:40].T, bias=True))
    assert (np.linalg.eigvalsh(c) > -1e-12).all()


@pytest.mark.parametrize(("dimensions", "feature"), [(1, L), (2, C), (3, N)])
def test_a_line_a_plane_and_a_ball_have_their_feature_near_one(dimensions, feature):
    rng = np.random.default_rng(dimensions)
    points = rng.uniform(-1, 1, (4000, 3)) * 30
    points[:, dimensions:] = 0.0
    points = points[np.argsort(np.linalg.norm(points, axis=1))]
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    f = features_of(points @ rotation.T, 250)[:400]  # those in the middle, whose neighbourhood is round
    assert np.median(f[:, feature]) > 0.75
    assert FEATURE_NAMES[np.argmax(np.median(f[:, [L, C, N]], axis=0)) + 1] == FEATURE_NAMES[feature]


def test_features_do_not_change_when_the_cloud_moves():
    rng = np.random.default_rng(3)
    points = rng.normal(0, [5, 3, 1], (300, 3))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    np.testing.assert_allclose(features_of(points), features_of(points @ rotation.T + [7, 8, 9]), atol=1e-8)


def test_identical_points_give_finite_features():
    assert np.isfinite(eigen_features(np.ones((10, 3)), np.tile(np.arange(10), (10, 1)))).all()


def test_the_scale_is_that_of_the_target():
    target = np.random.default_rng(4).normal(3.0, 2.0, (500, 7))
    scaled = FeatureScale.of(target).apply(target)
    np.testing.assert_allclose(scaled.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(scaled.std(axis=0), 1)


def test_the_normal_of_a_plane_is_its_normal():
    points = np.c_[np.random.default_rng(5).uniform(-5, 5, (200, 2)), np.zeros(200)]
    _, _, neighbours = AdaptiveKDTree(points).knn_of_kept(12)
    np.testing.assert_allclose(np.abs(normals(points, neighbours)[:, 2]), 1.0)
