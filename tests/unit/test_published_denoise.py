"""Noise removal, equations (4) to (8)."""

import itertools

import numpy as np
import pytest

from perception.errors import DegenerateCloudError
from perception.published.denoise import NoiseStatistics, keep_mask, noise_statistics
from perception.published.kdtree import AdaptiveKDTree


def statistics_of(points, radius, **options):
    return noise_statistics(AdaptiveKDTree(np.asarray(points, dtype=float)), radius, **options)


def test_eta_is_the_mean_neighbour_distance_and_the_cloud_statistics_leave_isolated_points_out():
    points = [[0, 0, 0], [1, 0, 0], [3, 0, 0], [50, 0, 0]]
    statistics = statistics_of(points, 2.5)
    np.testing.assert_allclose(statistics.eta[:3], [1.0, 1.5, 2.0])
    assert statistics.eta[3] == np.inf
    np.testing.assert_array_equal(statistics.neighbours, [1, 2, 1, 0])
    assert statistics.mean == pytest.approx(1.5)
    assert statistics.sigma == pytest.approx(np.std([1.0, 1.5, 2.0], ddof=1))  # (7) divides by I-1
    np.testing.assert_array_equal(keep_mask(statistics, 100.0), [True, True, True, False])


def test_equation_8_is_strict_on_both_sides():
    eta = np.array([1.0, 1.5, 2.0, np.inf])
    statistics = NoiseStatistics(eta, np.array([1, 1, 1, 0]), 1.5, 0.5)
    np.testing.assert_array_equal(keep_mask(statistics, 1.0), [False, True, False, False])
    np.testing.assert_array_equal(keep_mask(statistics, 1.0001), [True, True, True, False])


def test_the_one_sided_test_spares_dense_points():
    eta = np.array([0.2, 1.5, 3.0])
    statistics = NoiseStatistics(eta, np.ones(3, dtype=np.int64), 1.5, 0.5)
    np.testing.assert_array_equal(keep_mask(statistics, 1.0, two_sided=True), [False, True, False])
    np.testing.assert_array_equal(keep_mask(statistics, 1.0, two_sided=False), [True, True, False])


def test_without_any_spread_all_points_with_neighbours_stay():
    square = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [9, 9, 9]]
    statistics = statistics_of(square, 1.1)
    assert statistics.sigma == pytest.approx(0.0)
    np.testing.assert_array_equal(keep_mask(statistics, 0.5), [True] * 4 + [False])


def test_a_smaller_kappa_keeps_a_subset():
    rng = np.random.default_rng(0)
    cloud = np.concatenate([rng.uniform(0, 20, (800, 3)) * [1, 1, 0], rng.uniform(0, 20, (80, 3))])
    statistics = statistics_of(cloud, 3.0)
    for two_sided in (True, False):
        masks = [keep_mask(statistics, kappa, two_sided=two_sided) for kappa in (4, 3, 2, 1.5, 1, 0.6, 0.1)]
        for larger, smaller in itertools.pairwise(masks):
            assert (larger | ~smaller).all()
        assert masks[0].sum() > masks[-1].sum()


def test_scattered_points_go_and_the_surface_stays():
    rng = np.random.default_rng(1)
    surface = np.c_[rng.uniform(0, 60, (4000, 2)), rng.normal(0, 0.05, 4000)]
    scattered = rng.uniform([0, 0, 5], [60, 60, 30], (200, 3))
    keep = keep_mask(statistics_of(np.concatenate([surface, scattered]), 3.0), 3.0, two_sided=False)
    assert keep[:4000].mean() > 0.98
    assert keep[4000:].mean() < 0.5


def test_every_split_rule_gives_the_same_mask():
    rng = np.random.default_rng(2)
    cloud = rng.normal(0, [10, 20, 3], (1500, 3))
    masks = [
        keep_mask(noise_statistics(AdaptiveKDTree(cloud, split=rule), 2.0), 2.0) for rule in ("std", "cycle", "extent")
    ]
    np.testing.assert_array_equal(masks[0], masks[1])
    np.testing.assert_array_equal(masks[0], masks[2])


def test_a_cloud_of_isolated_points_is_refused():
    with pytest.raises(DegenerateCloudError, match="neighbour"):
        statistics_of(np.eye(3) * 100, 1.0)
