"""Keypoint ICP, its loss (17), and the extensions around it."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from perception.geometry import Pose
from perception.published import dense
from perception.published.registration import IcpSettings, kabsch, keypoint_icp, keypoint_loss, trimmed_distance
from perception.published.starts import start_poses

POSE = Pose.from_rotvec([0.1, -0.2, 0.3], [4.0, -5.0, 6.0])


def test_the_loss_is_the_mean_squared_distance_of_the_pairs():
    test = np.array([[0.0, 0, 0], [1, 1, 1]])
    target = np.array([[3.0, 4, 0], [1, 1, 2]])
    assert keypoint_loss(test, target) == pytest.approx((25 + 1) / 2)


@pytest.mark.parametrize("flat", [False, True])
def test_kabsch_returns_a_rotation_even_for_planar_points(flat):
    points = np.random.default_rng(0).normal(0, 10, (30, 3)) * ([1, 1, 0] if flat else [1, 1, 1])
    rotation, translation = kabsch(points[None], POSE.apply(points)[None])
    assert np.linalg.det(rotation[0]) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[0], POSE.rotation, atol=1e-9)
    np.testing.assert_allclose(translation[0], POSE.translation, atol=1e-9)


def test_kabsch_does_not_answer_a_mirror_image_with_a_reflection():
    points = np.random.default_rng(1).normal(0, 10, (30, 3))
    rotation, _ = kabsch(points[None], (points * [1, 1, -1])[None])
    assert np.linalg.det(rotation[0]) == pytest.approx(1.0)


def test_icp_recovers_ten_degrees():
    rng = np.random.default_rng(2)
    target = rng.uniform(-60, 60, (200, 3))
    true = Pose.from_rotvec(np.deg2rad(10) * np.array([0.6, 0.0, 0.8]), [3.0, -2.0, 1.0])
    result = keypoint_icp(true.inverse().apply(target), cKDTree(target), [Pose.identity()])[0]
    assert result.valid
    assert np.rad2deg(result.T_target_test.angle_to(true)) < 1e-4
    assert result.loss_mm2 < 1e-9


def test_trimming_ignores_keypoints_without_a_counterpart():
    rng = np.random.default_rng(3)
    target = rng.uniform(-60, 60, (200, 3))
    true = Pose.from_rotvec([0.03, 0.05, 0.0], [1.0, 1.0, 1.0])
    test = true.inverse().apply(target)
    test[:30] += rng.uniform(15, 25, (30, 3))
    trimmed, plain = (
        keypoint_icp(test, cKDTree(target), [Pose.identity()], IcpSettings(trims=t))[0].T_target_test
        for t in ((0.8,), (1.0,))
    )
    assert trimmed.angle_to(true) < 1e-5
    assert plain.angle_to(true) > 100 * trimmed.angle_to(true)


def test_a_batch_of_starts_gives_what_each_start_gives_alone():
    rng = np.random.default_rng(4)
    target = cKDTree(rng.uniform(-60, 60, (150, 3)))
    test = POSE.inverse().apply(np.asarray(target.data)) + rng.normal(0, 0.5, (150, 3))
    starts = [Pose.identity(), POSE, Pose.from_rotvec([0.5, 0, 0], [20.0, 0, 0])]
    for start, together in zip(starts, keypoint_icp(test, target, starts), strict=True):
        alone = keypoint_icp(test, target, [start])[0]
        np.testing.assert_allclose(alone.T_target_test.matrix, together.T_target_test.matrix, atol=1e-9)
        assert alone.iterations == together.iterations


@pytest.mark.parametrize(
    "points", [np.eye(3) * 10, np.outer(np.arange(20.0), [1, 2, 3]), np.ones((20, 3))], ids=["three", "line", "one"]
)
def test_too_few_or_collinear_keypoints_leave_the_start_and_say_so(points):
    good = np.random.default_rng(5).uniform(-50, 50, (50, 3))
    for test, target in ((points, good), (good, points)):
        result = keypoint_icp(test, cKDTree(target), [POSE])[0]
        assert not result.valid
        assert result.T_target_test is POSE


def test_the_score_ignores_the_worst_part():
    target = np.random.default_rng(6).uniform(-50, 50, (500, 3))
    test = target.copy()
    test[:100] += 500.0
    assert trimmed_distance(test, cKDTree(target), Pose.identity()) == 0.0
    assert trimmed_distance(test, cKDTree(target), Pose.identity(), keep=1.0) > 1000.0


def test_starts_hold_the_given_pose_and_27_rotations_with_medians_together():
    rng = np.random.default_rng(7)
    test, target = rng.normal(0, 10, (100, 3)), rng.normal(40, 10, (100, 3))
    starts = start_poses(test, target, POSE)
    assert len(starts) == 28
    assert starts[0] is POSE
    for pose in starts[1:]:
        np.testing.assert_allclose(pose.apply(np.median(test, axis=0)), np.median(target, axis=0), atol=1e-9)
    assert len({tuple(np.round(pose.rotation, 6).ravel()) for pose in starts[1:]}) == 27


def box_surface(rng, n):
    """Points and outward normals on three faces of a box: enough to fix all six directions."""
    uv = rng.uniform(-40, 40, (n, 2))
    face = rng.integers(0, 3, n)
    points = np.where(face[:, None] == 0, np.c_[uv, np.full(n, 40.0)], np.c_[uv[:, 0], np.full(n, 40.0), uv[:, 1]])
    points = np.where(face[:, None] == 2, np.c_[np.full(n, 40.0), uv], points)
    return points, np.eye(3)[[2, 1, 0]][face]


def test_dense_refinement_reaches_hundredths_despite_outliers():
    rng = np.random.default_rng(8)
    target, normal = box_surface(rng, 8000)
    test, _ = box_surface(rng, 2000)
    test = test + rng.normal(0, 0.1, test.shape)
    test[:200] = rng.uniform(-40, 40, (200, 3))
    true = Pose.from_rotvec([0.03, -0.02, 0.03], [2.0, -1.0, 1.5])
    found = dense.refine(true.inverse().apply(test), target, normal, cKDTree(target), Pose.identity(), (8, 4, 2, 1.5))
    assert np.rad2deg(found.angle_to(true)) < 0.05
    assert np.linalg.norm(found.apply(np.zeros(3)) - true.apply(np.zeros(3))) < 0.1


def test_dense_refinement_leaves_the_start_when_nothing_is_near():
    target, normal = box_surface(np.random.default_rng(9), 500)
    far = Pose.from_rotvec([0, 0, 0], [500.0, 0, 0])
    assert dense.refine(target, target, normal, cKDTree(target), far, (8, 4)) is far
