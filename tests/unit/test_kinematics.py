"""The arm's kinematics against itself, against known poses and, where it can be installed, ur-analytic-ik."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.arm.kinematics import (
    MODELS,
    JointLimits,
    forward,
    inverse,
    inverse_many,
    jacobian,
    nearest_branch,
    nearest_turn,
    sigma_min_many,
)
from drivers.arm.line_check import check_line
from perception.geometry import Pose, exp

NAMES = sorted(MODELS)
UR10E = MODELS["ur10e"]
HOME = np.radians([20.0, -100.0, 110.0, -100.0, -90.0, 10.0])
angles = st.lists(st.floats(-np.pi, np.pi), min_size=6, max_size=6).map(np.array)
models = st.sampled_from([MODELS[name] for name in NAMES])


def turn_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest joint difference modulo full turns."""
    return np.abs(np.mod(a - b + np.pi, 2 * np.pi) - np.pi).max(axis=-1)


def test_forward_at_zero_joints_is_the_arm_stretched_along_minus_x() -> None:
    pose = forward(UR10E, np.zeros(6))
    assert pose.translation == pytest.approx([-0.6127 - 0.57155, -0.17415 - 0.11655, 0.1807 - 0.11985])
    assert pose.rotation == pytest.approx(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), abs=1e-12)


@given(model=models, joints=angles)
@settings(max_examples=200, deadline=None)
def test_every_branch_reaches_the_pose(model, joints) -> None:
    pose = forward(model, joints)
    solutions = inverse(model, pose, free_q6=joints[5])
    assert len(solutions) > 0
    for solution in solutions:
        reached = forward(model, solution)
        assert reached.distance_to(pose) < 1e-5
        assert reached.angle_to(pose) < 1e-5


@given(model=models, joints=angles)
@settings(max_examples=200, deadline=None)
def test_the_joints_that_made_a_pose_are_among_its_solutions(model, joints) -> None:
    if sigma_min_many(model, joints[None])[0] < 1e-3:
        return  # at a singularity the pose no longer tells the joints apart
    solutions = inverse(model, forward(model, joints), free_q6=joints[5])
    assert turn_distance(solutions, joints).min() < 1e-6


@given(model=models, joints=angles)
@settings(max_examples=100, deadline=None)
def test_jacobian_is_the_derivative_of_forward(model, joints) -> None:
    step = 1e-6
    J = jacobian(model, joints)
    for k in range(6):
        ahead, behind = joints.copy(), joints.copy()
        ahead[k] += step
        behind[k] -= step
        a, b = forward(model, ahead), forward(model, behind)
        linear = (a.translation - b.translation) / (2 * step)
        angular = Pose(a.rotation @ b.rotation.T, np.zeros(3)).rotvec / (2 * step)
        assert J[:, k] == pytest.approx(np.concatenate([linear, angular]), abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_agrees_with_ur_analytic_ik(name) -> None:
    ur_analytic_ik = pytest.importorskip("ur_analytic_ik")
    oracle = getattr(ur_analytic_ik, name)
    rng = np.random.default_rng(1)
    for joints in rng.uniform(-np.pi, np.pi, (50, 6)):
        pose = forward(MODELS[name], joints)
        assert np.abs(pose.matrix - oracle.forward_kinematics(*joints)).max() < 1e-9
        expected = [np.ravel(solution) for solution in oracle.inverse_kinematics(pose.matrix)]
        mine = inverse(MODELS[name], pose)
        assert len(mine) == len(expected)
        for solution in expected:
            assert turn_distance(mine, solution).min() < 1e-6


def test_agrees_with_the_mock_controllers_own_kinematics() -> None:
    from mocks.ur.kinematics import MODELS as THEIRS
    from mocks.ur.kinematics import Kinematics

    rng = np.random.default_rng(3)
    assert sorted(THEIRS) == NAMES, "driver and mock know the same models"
    for name in NAMES:
        mock = Kinematics(THEIRS[name])
        for joints in rng.uniform(-np.pi, np.pi, (20, 6)):
            pose = forward(MODELS[name], joints)
            assert np.abs(pose.matrix - mock.flange(joints)).max() < 1e-9
            theirs, mine = mock.solutions(pose.matrix), inverse(MODELS[name], pose)
            assert len(theirs) == len(mine)
            for solution in theirs:
                assert turn_distance(mine, np.asarray(solution)).min() < 1e-6


def test_a_pose_out_of_reach_has_no_solution() -> None:
    assert len(inverse(UR10E, Pose(np.eye(3), np.array([1.6, 0.0, 0.3])))) == 0


def test_a_stack_gives_what_single_poses_give() -> None:
    rng = np.random.default_rng(2)
    poses = [forward(UR10E, joints) for joints in rng.uniform(-3, 3, (5, 6))]
    stacked = inverse_many(UR10E, np.stack([pose.matrix for pose in poses]))
    for pose, branches in zip(poses, stacked, strict=True):
        assert np.array_equal(inverse(UR10E, pose), branches[np.isfinite(branches).all(axis=1)])


def test_nearest_turn_takes_the_equivalent_next_to_the_reference_but_inside_the_limits() -> None:
    limits = JointLimits.symmetric(2 * np.pi)
    joints = np.full(6, -3.0)
    assert nearest_turn(joints, np.full(6, 3.2), limits) == pytest.approx(np.full(6, -3.0 + 2 * np.pi))
    assert nearest_turn(joints, np.full(6, -9.0), limits) == pytest.approx(joints)  # one turn down would be outside
    tight = JointLimits(np.full(6, -1.0), np.full(6, 1.0))
    assert np.isnan(nearest_turn(joints, np.zeros(6), tight)).all()


@given(joints=angles)
@settings(max_examples=100, deadline=None)
def test_nearest_branch_returns_to_joints_beyond_half_a_turn(joints) -> None:
    if sigma_min_many(UR10E, joints[None])[0] < 1e-3:
        return
    wound = joints + np.array([0.0, 0.0, 0.0, 2 * np.pi if joints[3] < 0 else -2 * np.pi, 0.0, 0.0])
    found = nearest_branch(UR10E, forward(UR10E, joints), wound, JointLimits.symmetric())
    assert found == pytest.approx(wound, abs=1e-6)


def test_sigma_min_vanishes_at_wrist_elbow_and_shoulder_singularities() -> None:
    straight_elbow = HOME.copy()
    straight_elbow[2] = 0.0
    aligned_wrist = HOME.copy()
    aligned_wrist[4] = 0.0
    values = sigma_min_many(UR10E, np.stack([HOME, straight_elbow, aligned_wrist]))
    assert values[0] > 0.05
    assert values[1] < 1e-9
    assert values[2] < 1e-9


def test_a_line_in_free_space_is_fine_and_ends_at_its_end() -> None:
    start = forward(UR10E, HOME)
    end = start @ exp([0.05, 0.02, 0.1, 0.1, 0.0, 0.2])
    check = check_line(UR10E, start, end, HOME, JointLimits.symmetric())
    assert check.ok
    assert check.joints[0] == pytest.approx(HOME, abs=1e-6)
    assert forward(UR10E, check.joints[-1]).distance_to(end) < 1e-6


def test_a_line_keeps_the_turn_of_the_present_joints() -> None:
    wound = HOME + np.array([0, 0, 0, 2 * np.pi, 0, 0])
    start = forward(UR10E, wound)
    check = check_line(UR10E, start, start.moved([0, 0, 0.05]), wound, JointLimits.symmetric())
    assert check.ok
    assert check.joints[0] == pytest.approx(wound, abs=1e-6)


def test_a_line_out_of_reach_says_how_far_it_goes() -> None:
    start = forward(UR10E, HOME)
    end = Pose(start.rotation, start.translation * np.array([3.0, 3.0, 1.0]))
    check = check_line(UR10E, start, end, HOME, JointLimits.symmetric())
    assert not check.ok
    assert not check.reachable
    assert "reach" in check.reasons[0]


def test_a_line_through_the_wrist_singularity_is_refused_though_both_ends_are_fine() -> None:
    before, after = HOME.copy(), HOME.copy()
    before[4], after[4] = -0.3, 0.3
    start, end = forward(UR10E, before), forward(UR10E, after)
    assert sigma_min_many(UR10E, np.stack([before, after])).min() > 0.02
    check = check_line(UR10E, start, end, before, JointLimits.symmetric())
    assert not check.ok
    assert check.reasons


def test_a_line_that_leaves_a_joint_range_names_the_joint() -> None:
    start = forward(UR10E, HOME)
    limits = JointLimits(HOME - 0.1, HOME + 0.1)
    end = Pose(start.rotation, start.translation + np.array([0.0, 0.0, 0.3]))
    check = check_line(UR10E, start, end, HOME, limits)
    assert check.reachable
    assert not check.within_limits
    assert check.reasons[0].startswith("joint ")
