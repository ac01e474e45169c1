"""The arm driver's small decisions, without any link: versions, models, numbers, and what became of a motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drivers.arm import messages as m
from drivers.arm import validate
from drivers.arm.errors import (
    ArmAbsentError,
    ArmVersionError,
    CollisionError,
    InvalidCommandError,
    LocalModeError,
    ProgramStartError,
    RegistersInUseError,
    UnreachableError,
)
from drivers.arm.kinematics import MODELS, JointLimits, forward
from drivers.arm.motion import MotionTracker
from drivers.arm.opening import check_version, same_model, start_error
from drivers.arm.settings import UrSettings, Workspace
from drivers.base import ArmState, Box, LinkOpenError, RobotMode, SafetyMode
from perception.geometry import Pose

HOME = np.radians([20.0, -100.0, 110.0, -100.0, -90.0, 10.0])
TCP = Pose.from_vector([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])


def make_settings(**changes: object) -> UrSettings:
    return dataclasses.replace(UrSettings("127.0.0.9", "ur10e", TCP, 2.0, (0.0, 0.0, 0.05)), **changes)


def make_state(joints=HOME, **changes: object) -> ArmState:
    state = ArmState(
        time_s=10.0,
        device_time_s=1.0,
        T_base_tcp=forward(MODELS["ur10e"], joints) @ TCP,
        T_flange_tcp=TCP,
        joints=np.array(joints),
        tcp_speed=np.zeros(6),
        wrench=np.zeros(6),
        mode=RobotMode.RUNNING,
        safety=SafetyMode.NORMAL,
        moving=False,
        program_running=True,
        speed_scaling=1.0,
    )
    return dataclasses.replace(state, **changes)


# --- opening ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [(5, 5), (3, 15), (10, 9), (4, 9)])
def test_versions_that_cannot_be_served(version) -> None:
    with pytest.raises(ArmVersionError):
        check_version(version, upper_registers=False)


def test_the_upper_registers_are_refused_where_the_library_breaks_them() -> None:
    check_version((5, 22), upper_registers=True)
    check_version((5, 23), upper_registers=False)
    with pytest.raises(ArmVersionError, match="upper"):
        check_version((5, 23), upper_registers=True)


@pytest.mark.parametrize(
    ("configured", "reported", "same"),
    [
        ("ur10e", "UR10", True),
        ("ur10e", "UR10e", True),
        ("ur20", "UR20", True),
        ("ur7e", "UR5", True),
        ("ur12e", "UR10", True),
        ("ur10e", "UR5", False),
        ("ur3e", "UR30", False),
        ("ur30", "UR3", False),
    ],
)
def test_a_model_is_known_by_the_dashboards_name(configured, reported, same) -> None:
    assert same_model(configured, reported) is same


@pytest.mark.parametrize(
    ("said", "error"),
    [
        (
            "ur_rtde: One of the RTDE input registers are already in use! Currently you must disable",
            RegistersInUseError,
        ),
        ("ur_rtde: Please enable remote control on the robot!", LocalModeError),
        ("ur_rtde: Failed to start control script, before timeout of 5 seconds", ProgramStartError),
        ("Could not connect to: 10.0.0.1 at 30004, verify the IP", ArmAbsentError),
        ("something\nnew", LinkOpenError),
    ],
)
def test_what_the_library_says_becomes_a_typed_error_of_one_line(said, error) -> None:
    made = start_error(said)
    assert type(made) is error
    assert "\n" not in made.cause


def test_an_unknown_model_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="ur10e"):
        make_settings(model="ur9")


# --- commands --------------------------------------------------------------------------------------------------------


def test_a_target_outside_the_workspace_is_refused() -> None:
    box = Workspace(np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.0]))
    inside = Pose(np.eye(3), np.array([0.5, 0.0, 0.5]))
    assert validate.target(inside, make_settings(workspace=box)) is inside
    with pytest.raises(InvalidCommandError, match="workspace"):
        validate.target(Pose(np.eye(3), np.array([0.5, 0.0, -0.1])), make_settings(workspace=box))


def test_a_joint_target_accounts_for_the_tcp() -> None:
    state = make_state()
    goal = state.T_base_tcp.moved([0.05, 0.0, 0.0])
    joints = validate.joint_target(goal, state, make_settings())
    assert (forward(MODELS["ur10e"], joints) @ TCP).distance_to(goal) < 1e-6


def test_a_target_beyond_the_joint_limits_is_refused() -> None:
    state = make_state()
    tight = make_settings(joint_limits=JointLimits(HOME - 0.2, HOME + 0.2))
    assert validate.joint_target(state.T_base_tcp, state, tight) == pytest.approx(HOME, abs=1e-6)
    aside = forward(MODELS["ur10e"], HOME + np.array([0.5, 0, 0, 0, 0, 0])) @ TCP
    with pytest.raises(UnreachableError, match="joint limits"):
        validate.joint_target(aside, state, tight)


def test_a_line_out_of_reach_is_refused() -> None:
    state = make_state()
    with pytest.raises(UnreachableError, match="reach"):
        validate.line(Pose(np.eye(3), np.array([2.0, 0.0, 0.5])), state, make_settings())


def test_a_path_into_a_box_is_refused_but_the_way_out_of_it_is_not() -> None:
    state = make_state()
    ahead = state.T_base_tcp.moved([0.0, 0.0, 0.25])
    path = validate.line(ahead, state, make_settings())
    wall = Box("cover", state.T_base_tcp.moved([0.0, 0.0, 0.15]), (0.05, 0.05, 0.02))
    with pytest.raises(CollisionError, match="tool and cover"):
        validate.clear(path, make_settings(boxes=(wall,)))
    validate.clear(path[::-1][-2:], make_settings(boxes=(wall,)))  # backs out of the overlap
    here = Box("cover", state.T_base_tcp, (0.05, 0.05, 0.02))
    back = validate.line(state.T_base_tcp.moved([0.0, 0.0, -0.2]), state, make_settings())
    validate.clear(back, make_settings(boxes=(here,)))


# --- the last motion -------------------------------------------------------------------------------------------------


class Following:
    """A tracker with one motion to HOME's pose under way."""

    def __init__(self) -> None:
        self.tracker = MotionTracker()
        self.number = self.tracker.next_id()
        self.tracker.begin(self.number, make_state().T_base_tcp)

    def look(self, phase: m.Phase, state: ArmState, over: str | None = None, number: int | None = None):
        status = m.Status(True, self.number if number is None else number, phase)
        return self.tracker.progress(status, 9.9, state, over)


def test_before_any_motion_nothing_runs_and_nothing_has_failed() -> None:
    progress = MotionTracker().progress(m.Status(True, 0, "idle"), 0.0, make_state(), None)
    assert (progress.motion_id, progress.running, progress.failed) == (0, False, False)


def test_a_motion_runs_until_the_script_says_done_and_the_arm_rests_at_the_target() -> None:
    following = Following()
    assert following.look("running", make_state()).running
    assert following.look("done", make_state(moving=True)).running
    done = following.look("done", make_state())
    assert (done.running, done.failed) == (False, False)


def test_the_status_of_an_earlier_motion_says_nothing_about_this_one() -> None:
    following = Following()
    assert following.look("done", make_state(), number=0).running
    assert following.look("failed", make_state(), number=0).running


def test_a_sample_from_before_the_end_does_not_prove_arrival() -> None:
    assert Following().look("done", make_state(time_s=9.0)).running


def test_done_elsewhere_than_at_the_target_is_a_failure() -> None:
    following = Following()
    elsewhere = make_state(HOME + np.array([0.02, 0, 0, 0, 0, 0]))
    assert following.look("done", elsewhere).running, "it may still settle"
    late = dataclasses.replace(elsewhere, time_s=11.0)
    progress = following.look("done", late)
    assert progress.failed
    assert "from its target" in progress.detail


def test_a_lost_link_or_an_ended_script_is_a_failure() -> None:
    assert Following().look("running", make_state(), over="link lost: its process was ended by SIGSEGV").failed
    stopped = Following().look("failed", make_state(safety=SafetyMode.PROTECTIVE_STOP))
    assert stopped.failed
    assert "PROTECTIVE_STOP" in stopped.detail


def test_an_outcome_does_not_change_any_more() -> None:
    following = Following()
    assert not following.look("done", make_state()).failed
    assert not following.look("failed", make_state(), over="later").failed


def test_a_restart_of_the_link_ends_a_motion_that_ran() -> None:
    following = Following()
    following.tracker.forget()
    assert following.look("done", make_state()).failed
