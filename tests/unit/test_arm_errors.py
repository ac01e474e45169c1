"""What an arm does not know of itself: the linear model against exact chains and the mock, and the driver's poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.arm.errors import UnreachableError
from drivers.arm.kinematics import MODELS, forward, frames_many
from drivers.arm.settings import UrSettings
from drivers.arm.true_pose import error_jacobians, told_pose, true_states
from drivers.base import ArmState, RobotMode, SafetyMode
from mocks.ur.arm import Arm as MockArm
from mocks.ur.arm import Sensor
from mocks.ur.kinematics import MODELS as MOCK_MODELS
from mocks.ur.kinematics import Kinematics, as_built
from mocks.ur.sag import Sag
from perception.calibration.arm_errors import COUNT, Weights, error_jacobian, gravity_torques, true_in_told
from perception.evaluation.calibration_cells import Chain
from perception.geometry import Pose

SIZES = np.array([2e-4] * 12 + [3.5e-4] * 6 + [4e-6])
BEFORE_THE_PORT = np.array([2.97, -1.2, 2.1, 2.2, -1.3, 0.0])
joints = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)
errors = st.lists(st.floats(-1.0, 1.0), min_size=COUNT, max_size=COUNT).map(lambda shares: SIZES * np.array(shares))


def erring_flange(q: np.ndarray, e: np.ndarray) -> Pose:
    """Exactly, by a chain with other lengths, zeros and sag."""
    rows = Chain.nominal().rows.copy()
    rows[:, 0] += e[:6]
    rows[:, 2] += e[6:12]
    return Chain(rows).flange(q + e[12:18] + e[18] * Chain.nominal().torques(q))


@given(joints, errors)
def test_to_first_order_is_good_to_two_micrometres(q: np.ndarray, e: np.ndarray) -> None:
    frames = frames_many(MODELS["ur10e"], q[None])
    estimated = forward(MODELS["ur10e"], q) @ Pose.from_matrix(true_in_told(frames, e, Weights())[0])
    true = erring_flange(q, e)
    assert estimated.distance_to(true) < 2e-6
    assert estimated.angle_to(true) < 4e-6


def test_gravity_pulls_each_joint_as_it_pulls_the_simulated_ones() -> None:
    q = np.random.default_rng(0).uniform(-2, 2, (5, 6))
    torques = gravity_torques(frames_many(MODELS["ur10e"], q), Weights())
    np.testing.assert_allclose(torques, [Chain.nominal().torques(one) for one in q], atol=1e-9)


def test_the_emulated_arm_errs_as_the_model_says() -> None:
    """The two share no code: lengths, zeros and sag of the mock against the Jacobian."""
    rng = np.random.default_rng(1)
    lengths, zeros, give = rng.uniform(-2e-4, 2e-4, 6), rng.uniform(-3e-4, 3e-4, 6), 3e-6
    nominal = Kinematics(MOCK_MODELS["ur10e"])
    built = Kinematics(as_built(nominal.model, lengths))
    arm = MockArm(nominal, BEFORE_THE_PORT, None, Sensor(rng, 0, 0, 0, 0), zeros, Sag(nominal, give), built)
    d1, a2, a3, d4, d5, d6 = lengths
    e = np.array([0, a2, a3, 0, 0, 0, d1, 0, 0, d4, d5, d6, *zeros, give])
    told = forward(MODELS["ur10e"], BEFORE_THE_PORT)
    estimated = told @ Pose.from_matrix(
        true_in_told(frames_many(MODELS["ur10e"], BEFORE_THE_PORT[None]), e, Weights())[0]
    )
    true = Pose.from_matrix(arm.T_base_flange_true)
    assert told.distance_to(true) > 2e-4
    assert estimated.distance_to(true) < 1e-6


T_FLANGE_TCP = Pose.from_vector([0.0, 0.01, 0.2, 0.0, 0.1, 0.3])
ERRORS = SIZES * np.random.default_rng(2).uniform(-1, 1, COUNT)
KNOWN = UrSettings("", "ur10e", T_FLANGE_TCP, 3.0, (0.0, 0.0, 0.08), errors=ERRORS)


def told_state(q: np.ndarray) -> ArmState:
    pose = forward(MODELS["ur10e"], q) @ T_FLANGE_TCP
    modes = RobotMode.RUNNING, SafetyMode.NORMAL
    return ArmState(0.0, 0.0, pose, T_FLANGE_TCP, q, np.zeros(6), np.zeros(6), *modes, False, True, 1.0)


@given(st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6))
def test_what_the_arm_is_told_brings_the_true_tcp_where_it_is_wanted(off: list[float]) -> None:
    q = BEFORE_THE_PORT + off
    wanted = erring_flange(q, ERRORS) @ T_FLANGE_TCP
    told = told_pose(wanted, BEFORE_THE_PORT, KNOWN)
    assert told.distance_to(told_state(q).T_base_tcp) < 5e-6
    assert told.angle_to(told_state(q).T_base_tcp) < 1e-5
    true = true_states([told_state(q)], KNOWN)[0]
    assert true.T_base_tcp.distance_to(wanted) < 5e-6
    assert true.T_base_flange.distance_to(erring_flange(q, ERRORS)) < 5e-6


def test_each_sample_is_corrected_by_its_own_joints_whatever_came_before() -> None:
    """A replay asks at other times than the mission did, and is to come to the same poses."""
    states = [told_state(BEFORE_THE_PORT + step) for step in (0.0, 4e-4, 0.5)]
    together = true_states(states, KNOWN)
    for state, true in zip(states, together, strict=True):
        assert true.T_base_flange.distance_to(erring_flange(state.joints, ERRORS)) < 4e-6
        alone = true_states([state], KNOWN)[0]
        np.testing.assert_allclose(alone.T_base_tcp.matrix, true.T_base_tcp.matrix, atol=1e-15)
    assert true_states([], KNOWN) == []


def test_an_arm_at_its_word_is_left_alone() -> None:
    ideal, state = replace(KNOWN, errors=None), told_state(BEFORE_THE_PORT)
    assert true_states([state], ideal)[0] is state
    assert told_pose(state.T_base_tcp, state.joints, ideal) is state.T_base_tcp


def test_a_pose_out_of_reach_is_left_to_the_checks_that_refuse_it_and_has_no_jacobian() -> None:
    far = Pose(np.eye(3), np.array([9.0, 0.0, 0.0]))
    assert told_pose(far, BEFORE_THE_PORT, KNOWN) is far
    with pytest.raises(UnreachableError, match="ur10e cannot reach"):
        error_jacobians(KNOWN, (far,), BEFORE_THE_PORT)


def test_the_jacobian_of_a_pose_is_that_of_the_branch_the_arm_is_on() -> None:
    poses = tuple(forward(MODELS["ur10e"], BEFORE_THE_PORT + step) for step in (0.0, 0.02))
    found = error_jacobians(KNOWN, poses, BEFORE_THE_PORT)
    expected = error_jacobian(frames_many(MODELS["ur10e"], np.add.outer([0.0, 0.02], BEFORE_THE_PORT)), Weights())
    np.testing.assert_allclose(found, expected, atol=1e-6)
