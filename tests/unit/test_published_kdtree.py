"""The adaptive KD-tree against numpy and scipy: equations (1) to (3), all split rules, both engines."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from perception.errors import DegenerateCloudError, EmptyScanError
from perception.published.kdtree import AdaptiveKDTree, numba_available
from perception.published.kdtree_numpy import LEAF

ENGINES = ["numpy", pytest.param("numba", marks=pytest.mark.skipif(not numba_available(), reason="numba absent"))]
RULES = ["std", "cycle", "extent"]


def clouds() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    line = np.outer(rng.uniform(-50, 50, 300), [1.0, 2.0, -0.5])
    duplicated = np.repeat(rng.normal(0, 5, (40, 3)), 20, axis=0)
    return {
        "random": rng.uniform(-10, 10, (700, 3)),
        "skewed": rng.exponential([1.0, 10.0, 100.0], (700, 3)) ** 1.5,
        "duplicated": duplicated,
        "identical": np.full((100, 3), 0.1),
        "collinear": line,
        "planar": np.c_[rng.uniform(-9, 9, (500, 2)), np.zeros(500)],
        "single": np.array([[1.0, 2.0, 3.0]]),
        "two": np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0]]),
    }


def scipy_statistics(points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    n = len(points)
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    d = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    return np.bincount(pairs.ravel(), minlength=n), np.bincount(pairs.ravel(), np.repeat(d, 2), n)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", list(clouds()))
def test_the_tree_answers_as_scipy_does(engine, rule, name):
    points = clouds()[name]
    tree = AdaptiveKDTree(points, leaf_size=8, split=rule, engine=engine)
    radius = 3.0
    counts, sums = tree.radius_stats(radius)
    expected_counts, expected_sums = scipy_statistics(points, radius)
    np.testing.assert_array_equal(counts, expected_counts)
    np.testing.assert_allclose(sums, expected_sums, rtol=1e-9, atol=1e-9)
    queries = np.concatenate([points[::7], points[:5] + 0.3, [[1e3, -1e3, 0.0]]])
    k = min(9, len(points))
    distances, indices = tree.query_knn(queries, k)
    expected, _ = cKDTree(points).query(queries, np.arange(1, k + 1))
    np.testing.assert_allclose(distances, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points[indices] - queries[:, None], axis=2), distances, atol=1e-12)
    found = tree.query_radius(queries, radius)
    for mine, theirs in zip(found, cKDTree(points).query_ball_point(queries, radius, return_sorted=True), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("engine", ENGINES)
def test_each_node_splits_on_its_axis_of_largest_standard_deviation_at_the_median(engine):
    points = np.random.default_rng(2).normal(0, [3.0, 1.0, 2.0], (900, 3))
    tree = AdaptiveKDTree(points, engine=engine).arrays
    inner = np.flatnonzero(tree.axis >= 0)
    assert len(inner) == 63
    for node in inner:
        own = tree.points[tree.start[node] : tree.end[node]]
        assert tree.axis[node] == np.argmax(np.std(own, axis=0))
        m, value = tree.axis[node], tree.split[node]
        left, right = 2 * node + 1, 2 * node + 2
        assert tree.end[left] - tree.start[left] == len(own) // 2
        assert tree.end[left] == tree.start[right]
        assert value == np.sort(own[:, m])[len(own) // 2]
        assert (tree.points[tree.start[left] : tree.end[left], m] <= value).all()
        assert (tree.points[tree.start[right] : tree.end[right], m] >= value).all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("n", "leaf"), [(1, 16), (16, 16), (17, 16), (1000, 16), (4096, 8), (33, 1)])
def test_the_depth_is_that_of_a_median_split_whatever_the_rule(engine, rule, n, leaf):
    points = np.random.default_rng(n).exponential(1.0, (n, 3))
    assert AdaptiveKDTree(points, leaf, rule, engine=engine).stats.depth == math.ceil(math.log2(max(1.0, n / leaf)))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("n", [1024, 10_000])
def test_the_build_touches_each_point_once_a_level(engine, n):
    stats = AdaptiveKDTree(np.random.default_rng(0).normal(size=(n, 3)), engine=engine).stats
    assert stats.points_touched == n * stats.depth


@pytest.mark.parametrize("engine", ENGINES)
def test_identical_points_make_one_oversize_leaf(engine):
    tree = AdaptiveKDTree(np.full((500, 3), 0.1), leaf_size=4, engine=engine)
    assert tree.stats.leaves == 1
    counts, sums = tree.radius_stats(1.0)
    assert (counts == 499).all()
    assert (sums == 0).all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("rule", RULES)
def test_points_that_are_not_finite_are_dropped_and_counted(engine, rule):
    points = np.random.default_rng(3).normal(size=(60, 3))
    points[[4, 17, 33]] = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]]
    tree = AdaptiveKDTree(points, split=rule, leaf_size=4, engine=engine)
    assert tree.dropped == 3
    counts, _ = tree.radius_stats(100.0)
    assert (counts[[4, 17, 33]] == 0).all()
    assert (np.delete(counts, [4, 17, 33]) == 56).all()
    _, indices = tree.query_knn(np.zeros((1, 3)), 57)
    assert set(indices[0]) == set(range(60)) - {4, 17, 33}


def test_a_cloud_without_points_is_refused():
    with pytest.raises(EmptyScanError):
        AdaptiveKDTree(np.empty((0, 3)))
    with pytest.raises(EmptyScanError):
        AdaptiveKDTree(np.full((5, 3), np.nan))
    with pytest.raises(DegenerateCloudError):
        AdaptiveKDTree(np.zeros((5, 2)))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_mask_hides_points_without_a_rebuild(engine):
    points = np.random.default_rng(4).normal(size=(400, 3))
    tree = AdaptiveKDTree(points, engine=engine)
    nodes_before = tree.arrays
    keep = np.random.default_rng(5).random(400) < 0.3
    tree.keep_only(keep)
    assert tree.arrays is nodes_before
    assert (tree.stats.builds, tree.stats.mask_values_written) == (1, 400)
    distances, indices = tree.query_knn(points, 12)
    expected, _ = cKDTree(points[keep]).query(points, 12)
    np.testing.assert_allclose(distances, expected, atol=1e-12)
    assert keep[indices].all()
    rows, same, _ = tree.knn_of_kept(12)
    np.testing.assert_array_equal(rows, np.flatnonzero(keep))
    np.testing.assert_allclose(same, expected[keep], atol=1e-12)
    with pytest.raises(DegenerateCloudError):
        tree.query_knn(points, int(keep.sum()) + 1)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 60), st.integers(1, 5), st.sampled_from(RULES), st.floats(0.1, 4.0), st.integers(0, 2**16))
def test_grids_with_many_ties_agree_with_scipy(n, leaf, rule, radius, seed):
    points = np.random.default_rng(seed).integers(0, 4, (n, 3)).astype(float)
    expected, _ = scipy_statistics(points, radius)
    for engine in ("numpy", "numba") if numba_available() else ("numpy",):
        counts, _ = AdaptiveKDTree(points, leaf, rule, engine=engine).radius_stats(radius)
        np.testing.assert_array_equal(counts, expected)


def test_every_point_lies_in_exactly_one_leaf():
    tree = AdaptiveKDTree(np.random.default_rng(6).normal(size=(777, 3)), engine="numpy").arrays
    leaves = np.flatnonzero(tree.axis == LEAF)
    assert (tree.end[leaves] - tree.start[leaves]).sum() == 777
    assert sorted(tree.order) == list(range(777))
