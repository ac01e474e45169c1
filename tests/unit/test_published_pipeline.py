"""The published method as a whole: what it finds, what it refuses, how its rounds relate."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from perception.errors import DegenerateCloudError, EmptyScanError, UnitError
from perception.geometry import Pose
from perception.published import clouds, kdtree, pipeline
from perception.published.kdtree import AdaptiveKDTree
from perception.published.merging import merge_views
from perception.published.pipeline import register
from perception.published.profiles import FAITHFUL, LITERAL, ROBUST
from perception.published.registration import trimmed_distance
from perception.published.target import prepare_target

TRUE = Pose.from_rotvec(np.deg2rad(6.0) * np.array([0.6, 0.0, 0.8]), [3.0, -2.0, 1.5])
"""T_target_test"""


def inlet(rng, n):
    """A face with three round wells of different sizes and depths: enough edges, no symmetry."""
    xy = rng.uniform(-40, 40, (n, 2))
    z = np.zeros(n)
    for centre, radius, depth in (((-15, 12), 9, 12), ((18, 10), 6, 20), ((2, -18), 12, 8)):
        offset = xy - centre
        distance = np.linalg.norm(offset, axis=1)
        floor, wall = distance < 0.8 * radius, (distance >= 0.8 * radius) & (distance < radius)
        z[floor] = -depth
        xy[wall] = np.array(centre) + offset[wall] / distance[wall, None] * radius
        z[wall] = -depth * rng.random(wall.sum())
    return np.c_[xy, z]


@pytest.fixture(scope="module")
def target():
    return inlet(np.random.default_rng(0), 5000)


@pytest.fixture(scope="module")
def scan():
    rng = np.random.default_rng(1)
    points = inlet(rng, 4000) + rng.normal(0, 0.1, (4000, 3))
    points[:150] = rng.uniform([-40, -40, -25], [40, 40, 25], (150, 3))
    return TRUE.inverse().apply(points)


def error(found):
    e = found.T_target_test @ TRUE.inverse()
    return np.rad2deg(e.angle_to(Pose.identity())), np.linalg.norm(e.translation)


def test_the_robust_profile_reaches_tenths_on_a_sparse_noisy_scan(target, scan):
    found = register(scan, target, "robust")
    angle, shift = error(found)
    assert found.converged
    assert angle < 0.25
    assert shift < 0.1


def test_the_faithful_profile_comes_close_and_its_best_round_is_never_worse_than_its_first(target, scan):
    found = register(scan, target, "faithful")
    angle, shift = error(found)
    assert angle < 4.0
    assert shift < 2.5
    assert found.score_mm2 <= found.rounds[0].score_mm2
    assert found.score_mm2 == min(r.score_mm2 for r in found.rounds)
    kappas = [r.kappa for r in found.rounds]
    assert kappas == sorted(kappas, reverse=True)


def test_the_literal_profile_says_that_the_printed_feedback_cannot_go_on(target, scan):
    found = register(scan, target, "literal")
    assert len(found.rounds) == 1
    assert not found.converged
    assert "kappa" in found.stopped


def test_the_split_rule_changes_no_result(target, scan):
    results = [register(scan, target, replace(FAITHFUL, split=rule)) for rule in ("std", "cycle", "extent")]
    for other in results[1:]:
        np.testing.assert_array_equal(results[0].kept, other.kept)
        np.testing.assert_allclose(results[0].T_target_test.matrix, other.T_target_test.matrix, atol=1e-6)


def test_a_new_kappa_rebuilds_nothing(target, scan, monkeypatch):
    built = []
    original = AdaptiveKDTree.__init__

    def counting(self, points, *args, **options):
        built.append(len(points))
        original(self, points, *args, **options)

    prepared = prepare_target(target, FAITHFUL)
    monkeypatch.setattr(AdaptiveKDTree, "__init__", counting)
    feedback = replace(FAITHFUL.feedback, max_rounds=4, stop_early=False)
    found = register(scan, prepared, replace(FAITHFUL, feedback=feedback))
    assert len(found.rounds) == 4
    assert len({r.kappa for r in found.rounds}) > 1
    assert built == [len(scan)]


def test_all_rounds_are_ranked_on_the_points_that_the_first_one_kept(target, scan, monkeypatch):
    ranked = []

    def recording(points, *args):
        ranked.append(points)
        return trimmed_distance(points, *args)

    monkeypatch.setattr(pipeline, "trimmed_distance", recording)
    feedback = replace(FAITHFUL.feedback, max_rounds=4, stop_early=False)
    found = register(scan, target, replace(FAITHFUL, feedback=feedback))
    assert len({int(r.kept.sum()) for r in found.rounds}) > 1  # each round keeps other points
    assert len(ranked) == 4
    for points in ranked:
        np.testing.assert_array_equal(points, ranked[0])
    assert {tuple(p) for p in ranked[0]} <= {tuple(p) for p in scan[found.rounds[0].kept]}


def test_without_numba_the_method_runs_on_numpy_alone_and_answers_the_same(target, scan, monkeypatch):
    usual = register(scan, target, "faithful")
    monkeypatch.setattr(kdtree.importlib.util, "find_spec", lambda name: None)
    for module in ("numba", "perception.published.kdtree_numba", "perception.published.kdtree_kernels"):
        monkeypatch.setitem(sys.modules, module, None)  # importing it fails
    assert not kdtree.numba_available()
    found = register(scan, target, "faithful")
    np.testing.assert_array_equal(found.kept, usual.kept)
    np.testing.assert_allclose(found.T_target_test.matrix, usual.T_target_test.matrix, atol=1e-6)


def test_a_prepared_target_gives_the_same_answer_every_time(target, scan):
    prepared = prepare_target(target, ROBUST)
    first, second = register(scan, prepared, ROBUST), register(scan, prepared, ROBUST)
    np.testing.assert_array_equal(first.T_target_test.matrix, second.T_target_test.matrix)


def test_points_that_are_not_finite_are_dropped_and_counted(target, scan):
    broken = np.concatenate([scan, np.full((7, 3), np.nan)])
    found = register(broken, target, "robust")
    assert found.dropped == 7
    assert not found.kept[-7:].any()
    assert error(found)[1] < 0.1


@pytest.mark.parametrize("settings", [LITERAL, FAITHFUL, ROBUST], ids=lambda s: s.name)
@pytest.mark.parametrize(
    ("cloud", "expected"),
    [
        (np.empty((0, 3)), EmptyScanError),
        (np.full((500, 3), np.nan), EmptyScanError),
        (np.random.default_rng(2).uniform(-0.04, 0.04, (500, 3)), UnitError),
        (np.random.default_rng(2).uniform(-4e4, 4e4, (500, 3)), UnitError),
        (np.random.default_rng(2).uniform(-40, 40, (20, 3)), DegenerateCloudError),
        (np.ones((500, 3)) * 7.0, DegenerateCloudError),
        (np.random.default_rng(2).uniform(-40, 40, (500, 1)) * [1.0, 2.0, 3.0], DegenerateCloudError),
        (np.random.default_rng(2).uniform(-40, 40, (500, 3)) * [1.0, 1.0, 0.0], DegenerateCloudError),
    ],
    ids=["empty", "nan", "metres", "too-large", "fewer-than-k", "identical", "collinear", "planar"],
)
def test_a_cloud_that_cannot_determine_a_pose_is_refused_with_the_reason(target, settings, cloud, expected):
    with pytest.raises(expected) as caught:
        register(cloud, prepare_target(target, settings), settings)
    assert caught.value.cause
    assert caught.value.remedy
    with pytest.raises(expected):
        prepare_target(cloud, settings)


def test_metres_are_taken_when_named():
    np.testing.assert_allclose(clouds.in_millimetres(np.eye(3) * 0.05, "m"), np.eye(3) * 50)


def test_views_are_merged_in_the_first_ones_frame():
    rng = np.random.default_rng(5)
    turns = [Pose.identity(), TRUE, Pose.from_rotvec([-0.08, 0.05, 0.0], [-4.0, 2.0, 5.0])]
    views = []
    for k, pose in enumerate(turns):
        points = inlet(rng, 3000)
        points = points[points[:, 0] * (-1) ** k < 34]  # each lacks another side
        views.append(pose.apply(points + rng.normal(0, 0.05, points.shape)))
    merged = merge_views(views)
    for pose, found in zip(turns, merged.T_first_view, strict=True):
        assert np.linalg.norm((found @ pose).translation) < 0.25
        assert np.rad2deg((found @ pose).angle_to(Pose.identity())) < 0.3
    assert len(merged.cloud(views)) == sum(map(len, views))


def test_views_of_different_things_are_not_merged():
    rng = np.random.default_rng(6)
    ball = rng.normal(size=(2000, 3))
    ball *= 60 / np.linalg.norm(ball, axis=1, keepdims=True)
    with pytest.raises(DegenerateCloudError, match="fits"):
        merge_views([inlet(rng, 3000), ball + rng.normal(0, 6, ball.shape)])
