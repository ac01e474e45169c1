"""Kinematics, motions and the arm of the emulated controller."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mocks.spatial import matrix_of, moved_by, pose_of, rotation_of, rotvec_of
from mocks.ur.arm import Arm, ForceMode, FreeSpace, Sensor
from mocks.ur.kinematics import MODELS, Kinematics
from mocks.ur.motion import Halt, JointMove, LinearMove, MotionError, Servo, ToolVelocity

JOINTS = np.array([0.3, -1.4, 1.6, -1.2, -1.5, 0.2])
DT = 0.008
joints = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


def _arm(environment: object | None = None, noise: float = 0.0) -> Arm:
    sensor = Sensor(np.random.default_rng(1), noise, 0.0, 0.0, 0.0)
    return Arm(Kinematics(MODELS["ur10e"]), JOINTS, environment or FreeSpace(), sensor)  # type: ignore[arg-type]


def _run(arm: Arm, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        arm.step(DT)


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="ur-analytic-ik has wheels for Python 3.11 only")
@pytest.mark.parametrize("name", sorted(MODELS))
def test_forward_kinematics_agree_with_an_independent_library(name: str) -> None:
    library = getattr(pytest.importorskip("ur_analytic_ik"), name)
    for q in np.random.default_rng(2).uniform(-3, 3, (20, 6)):
        assert Kinematics(MODELS[name]).flange(q) == pytest.approx(library.forward_kinematics(*q), abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(MODELS)), joints)
@example("ur10e", np.array([0.0, -0.0625, 0.0, 0.0, 0.0, 0.0]))
def test_every_inverse_solution_reaches_the_pose(name: str, q: np.ndarray) -> None:
    kinematics = Kinematics(MODELS[name])
    T = kinematics.flange(q)
    solutions = kinematics.solutions(T, q6_if_free=float(q[5]))
    assert len(solutions) > 0
    for solution in solutions:
        assert kinematics.flange(solution) == pytest.approx(T, abs=3e-6)


def test_the_solution_nearest_to_the_present_joints_is_taken_also_beyond_half_a_turn() -> None:
    kinematics = Kinematics(MODELS["ur5e"])
    q = np.array([3.5, -1.2, 1.1, -4.0, 1.3, -3.9])
    assert kinematics.inverse(kinematics.flange(q), q + 0.05) == pytest.approx(q, abs=1e-9)


def test_a_pose_out_of_reach_has_no_solution() -> None:
    assert Kinematics(MODELS["ur3e"]).inverse(matrix_of([2.0, 0.0, 0.3, 0.0, 0.0, 0.0]), JOINTS) is None


@given(st.lists(st.floats(-1.8, 1.8), min_size=3, max_size=3))
def test_rotation_vectors_survive_the_way_through_a_matrix(rotvec: list[float]) -> None:
    if np.linalg.norm(rotvec) < math.pi - 1e-6:
        assert rotvec_of(rotation_of(rotvec)) == pytest.approx(rotvec, abs=1e-7)


def test_half_a_turn_keeps_its_axis() -> None:
    axis = np.array([0.6, -0.8, 0.0])
    assert rotation_of(rotvec_of(rotation_of(axis * math.pi))) == pytest.approx(rotation_of(axis * math.pi), abs=1e-6)


def test_a_joint_move_is_a_trapezoid_of_the_leading_joint() -> None:
    arm, target = _arm(), JOINTS + np.array([0.5, -0.25, 0.0, 0.0, 0.0, 0.0])
    move = arm.start(JointMove(target, speed=0.5, acceleration=1.0))
    peak, elapsed = np.zeros(6), 0.0
    while not move.done:
        arm.step(DT)
        elapsed += DT
        peak = np.maximum(peak, np.abs(arm.qd))
    assert arm.q == pytest.approx(target)
    assert peak[:2] == pytest.approx([0.5, 0.25], rel=0.01)
    assert elapsed == pytest.approx(0.5 / 0.5 + 0.5, abs=2 * DT)  # length / speed + speed / acceleration


def test_a_linear_move_stays_on_the_line_and_arrives() -> None:
    arm = _arm()
    start = arm.reference.T_base_tcp.copy()
    target = moved_by(start, np.array([0.1, 0.05, -0.1, 0.0, 0.1, 0.1]))
    move = arm.start(LinearMove(target, speed=0.25, acceleration=1.2))
    direction = (target - start)[:3, 3] / np.linalg.norm((target - start)[:3, 3])
    while not move.done:
        arm.step(DT)
        offset = arm.reference.T_base_tcp[:3, 3] - start[:3, 3]
        assert np.linalg.norm(offset - direction * (offset @ direction)) < 1e-6
        assert np.linalg.norm(arm.tool_speed()[:3]) < 0.252
    assert arm.reference.T_base_tcp == pytest.approx(target, abs=1e-6)


def test_a_move_out_of_reach_ends_the_motion_where_the_arm_is() -> None:
    arm = _arm()
    arm.start(LinearMove(matrix_of([3.0, 0.0, 0.3, 0.0, 0.0, 0.0]), 0.25, 1.2))
    with pytest.raises(MotionError):
        arm.step(DT)
    assert arm.q == pytest.approx(JOINTS) and arm.steady


def test_tool_velocity_goes_on_until_it_is_replaced() -> None:
    arm = _arm()
    start = arm.reference.T_base_tcp[:3, 3].copy()
    arm.start(ToolVelocity(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]), 0.5))
    _run(arm, 2.0)
    assert arm.reference.T_base_tcp[:3, 3] - start == pytest.approx([0.0, 0.0, 0.02 * 1.98], abs=5e-4)
    arm.start(Halt(1.0, linear=True))
    _run(arm, 0.2)
    assert arm.steady


def test_the_slider_slows_a_move_down_without_leaving_its_path() -> None:
    arm = _arm()
    target = JOINTS + 0.1
    arm.slider = 0.25
    move = arm.start(JointMove(target, 0.4, 2.0))
    elapsed = 0.0
    while not move.done:
        arm.step(DT)
        elapsed += DT
    assert elapsed == pytest.approx(4.0 * (0.1 / 0.4 + 0.4 / 2.0), rel=0.03)
    assert arm.q == pytest.approx(target)


def test_a_pause_holds_the_arm_and_a_resume_finishes_the_old_motion() -> None:
    arm = _arm()
    arm.start(JointMove(JOINTS + 0.3, 0.4, 2.0))
    _run(arm, 0.4)
    arm.paused = True
    _run(arm, 0.3)
    held = arm.q.copy()
    _run(arm, 1.0)
    assert arm.q == pytest.approx(held) and arm.steady
    arm.paused = False
    _run(arm, 2.0)
    assert arm.q == pytest.approx(JOINTS + 0.3)


def test_a_servo_follows_a_moving_target_with_a_lag() -> None:
    arm = _arm()
    for k in range(250):
        arm.start(Servo(JOINTS + 0.1 * k * DT, 0.1))
        arm.step(DT)
    lag = (JOINTS + 0.1 * 249 * DT - arm.q) / 0.1
    assert lag == pytest.approx(np.full(6, 0.1), abs=0.02)


class _Wall:
    """A wall of the base's x-y plane at the height where the arm starts, of 20 N/mm."""

    def __init__(self, height_m: float) -> None:
        self.height_m = height_m

    def step(self, T_base_flange: np.ndarray, dt: float) -> np.ndarray:
        return np.array([0.0, 0.0, 20e3 * max(0.0, self.height_m - T_base_flange[2, 3]), 0.0, 0.0, 0.0])


def test_force_mode_presses_with_the_force_asked_for_and_within_its_speed_limit() -> None:
    arm = _arm()
    height = arm.reference.T_base_tcp[2, 3] - 0.01
    arm.environment = _Wall(height)
    limits = np.array([0.01, 0.01, 0.02, 0.1, 0.1, 0.1])
    select = (False, False, True, False, False, False)
    arm.enter_force_mode(ForceMode(np.eye(4), select, np.array([0.0, 0.0, -30.0, 0.0, 0.0, 0.0]), limits))
    fastest = 0.0
    for _ in range(250):
        arm.step(DT)
        fastest = max(fastest, abs(arm.tool_speed()[2]))
    assert fastest < 0.0201
    assert arm.true_wrench[2] == pytest.approx(30.0, abs=0.5)
    assert arm.reference.T_base_tcp[2, 3] == pytest.approx(height - 30.0 / 20e3, abs=1e-4)


def test_zeroing_removes_the_bias_of_the_sensor() -> None:
    arm = Arm(Kinematics(MODELS["ur10e"]), JOINTS, FreeSpace(), Sensor(np.random.default_rng(3), 0.3, 0.01, 3.0, 0.1))
    _run(arm, 0.5)
    before = np.linalg.norm(arm.sensor.filtered[:3])
    arm.sensor.zero()
    _run(arm, 0.5)
    assert before > 1.0 and np.linalg.norm(arm.sensor.filtered[:3]) < 1.0


def test_pose_vectors_read_as_universal_robots_writes_them() -> None:
    assert pose_of(matrix_of([0.1, 0.2, 0.3, 0.0, math.pi / 2, 0.0])) == pytest.approx(
        [0.1, 0.2, 0.3, 0, math.pi / 2, 0]
    )
    assert matrix_of([0, 0, 0, 0, 0, math.pi / 2])[:3, 0] == pytest.approx([0.0, 1.0, 0.0])
