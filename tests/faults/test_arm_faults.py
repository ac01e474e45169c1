"""What goes wrong with an arm while it moves: what the driver reports, that the emulated arm stands still, and back.

The rows follow the ways in which ur_rtde is known to fail. Where a time matters it is measured between what the host
did and what the driver says, with room for a busy machine.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import (
    ControlLinkLostError,
    FrozenStateError,
    ProgramStoppedError,
    SafetyStopError,
)
from drivers.base import Compliance, LinkLostError, RobotMode, SafetyMode
from tests.arm_rig import Rig, host_process, until

UP = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def shared():
    made = Rig()
    yield made
    made.close()


@pytest.fixture
def rig(shared):
    """The one rig, in order, with the arm back where it began."""
    yield shared
    mock = shared.mock
    mock.do("freeze", seconds=0.0)
    mock.do("slider", fraction=1.0)
    mock.do("up", link="all")
    mock.do("release_estop")
    mock.do("safety", mode="NORMAL")
    with Dashboard(mock.host) as dashboard:
        for command in ("stop", "power on", "brake release"):
            dashboard.ask(command)
        until(lambda: dashboard.robot_mode() == "RUNNING", "the controller is ready")
    shared.arm.recover()
    shared.kicker.resume()
    back = shared.arm.move_joints(shared.home, 1.0, 2.0)
    assert not shared.finish(back).failed


@pytest.fixture
def rig_to_kill():
    made = Rig()
    yield made
    made.close()


def set_moving(rig: Rig) -> int:
    """A long straight motion, under way."""
    motion = rig.arm.move_linear(rig.arm.state().T_base_tcp.moved([0.0, 0.0, -0.15]), 0.03, 0.5)
    rig.until_moving()
    return motion


def worker_pid(rig: Rig) -> int:
    return rig.arm._links.worker.pid


def works_again(rig: Rig) -> None:
    """After recovery the arm stands still until it is told to move, and then moves."""
    rig.mock.until_still()
    progress = rig.finish(rig.arm.move_linear(rig.arm.state().T_base_tcp.moved([0.0, 0.0, -0.02]), 0.1, 0.5))
    assert not progress.failed, progress.detail


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


# --- the control worker ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP])
def test_a_crashed_or_hung_worker_is_a_fault_at_once_and_the_arm_stops(rig, number) -> None:
    motion = set_moving(rig)
    os.kill(worker_pid(rig), number)
    took = until(lambda: not rig.arm.health().up, "the link is reported lost")
    assert took < 0.5  # 0.1 on a quiet machine; benchmarks measure it
    progress = rig.arm.motion()
    assert (progress.motion_id, progress.running, progress.failed) == (motion, False, True)
    with pytest.raises(ControlLinkLostError):
        rig.arm.move_velocity(UP, 0.5)
    with pytest.raises(ControlLinkLostError):
        rig.arm.kick_watchdog()
    rig.mock.until_still()
    assert rig.arm.state().T_base_tcp is not None, "state goes on without the worker"
    rig.arm.recover()
    works_again(rig)


def test_a_lost_worker_in_force_mode_leaves_no_force(rig) -> None:
    frame = rig.arm.state().T_base_tcp
    rig.arm.comply(Compliance(frame, (False, False, True, False, False, False), (0, 0, 5.0, 0, 0, 0), (0.02,) * 6))
    until(lambda: rig.mock.state()["force_mode"], "force mode is on")
    os.kill(worker_pid(rig), signal.SIGKILL)
    until(lambda: not rig.mock.state()["force_mode"], "force mode ends")
    rig.mock.until_still()


def test_stop_works_over_the_dashboard_without_a_worker(rig) -> None:
    rig.arm.move_velocity(UP, 0.5)
    rig.until_moving()
    os.kill(worker_pid(rig), signal.SIGKILL)
    rig.arm.stop()  # no error: the dashboard answered
    rig.mock.until_still()


# --- the network -----------------------------------------------------------------------------------------------------


def test_frozen_data_is_seen_by_the_controllers_clock(rig) -> None:
    set_moving(rig)
    rig.mock.do("freeze", seconds=3.0)
    with pytest.raises(FrozenStateError):
        until(lambda: rig.arm.state() is None, "state is stale")
    with pytest.raises(FrozenStateError):
        rig.arm.move_velocity(UP, 0.5)
    rig.kicker.pause()  # as the supervisor does with stale state
    rig.mock.until_still()


def test_a_robot_that_vanishes_is_reported_and_no_call_hangs(rig_to_kill) -> None:
    rig = rig_to_kill
    motion = set_moving(rig)
    rig.mock.kill()
    until(lambda: not rig.arm.health().up, "the loss is reported")
    assert (rig.arm.motion().motion_id, rig.arm.motion().failed) == (motion, True)
    until(lambda: rig.arm._links.worker.lost is not None, "the control link is lost as well")
    begun = time.monotonic()
    for call in (rig.arm.state, rig.arm.kick_watchdog, rig.arm.stop, rig.arm.zero_force_sensor):
        with pytest.raises(LinkLostError):
            call()
    assert time.monotonic() - begun < 5.0


def test_a_controller_that_stops_executing_blocks_no_caller_for_long(rig) -> None:
    rig.arm.move_velocity(UP, 0.5)
    rig.until_moving()
    rig.mock.process.send_signal(signal.SIGSTOP)
    try:
        begun = time.monotonic()
        with pytest.raises(LinkLostError):
            rig.arm.stop()
        with pytest.raises(LinkLostError):
            rig.arm.kick_watchdog()
        assert time.monotonic() - begun < 3.0  # 1 on a quiet machine
    finally:
        rig.mock.process.send_signal(signal.SIGCONT)
    rig.mock.until_still()


# --- safety ----------------------------------------------------------------------------------------------------------


def test_after_a_protective_stop_nothing_resumes_and_an_operator_is_needed(rig) -> None:
    set_moving(rig)
    rig.mock.do("protective_stop")
    until(lambda: rig.arm.state().safety == SafetyMode.PROTECTIVE_STOP, "the state tells")
    until(lambda: rig.arm.motion().failed, "the motion has failed")
    with pytest.raises(ProgramStoppedError):
        rig.arm.move_velocity(UP, 0.5)
    until(lambda: rig.mock.state()["program"] is None, "the paused program is ended")
    with pytest.raises(SafetyStopError):
        rig.arm.recover()
    assert rig.arm.state().safety == SafetyMode.PROTECTIVE_STOP, "software does not release it, and still sees it"
    rig.mock.do("safety", mode="NORMAL")  # the operator's acknowledgement
    with Dashboard(rig.mock.host) as dashboard:
        dashboard.ask("play")
    rig.mock.until_still()
    rig.arm.recover()
    works_again(rig)


def test_an_emergency_stop_and_the_way_back(rig) -> None:
    set_moving(rig)
    rig.mock.do("estop")
    until(lambda: rig.arm.state().safety == SafetyMode.ROBOT_ESTOP, "the state tells")
    until(lambda: rig.arm.motion().failed, "the motion has failed")
    assert rig.arm.state().mode != RobotMode.RUNNING
    rig.arm.stop()  # never raises for an arm at rest
    rig.mock.until_still()
    with pytest.raises(SafetyStopError):
        rig.arm.recover()
    rig.mock.do("release_estop")
    with Dashboard(rig.mock.host) as dashboard:
        for command in ("close safety popup", "power on", "brake release"):
            dashboard.ask(command)
        until(lambda: dashboard.robot_mode() == "RUNNING", "the arm is ready")
    rig.arm.recover()
    works_again(rig)


def test_a_safeguard_stop_that_ends_does_not_let_the_motion_go_on(rig) -> None:
    set_moving(rig)
    rig.mock.do("safeguard", open=True)
    until(lambda: rig.arm.state().safety == SafetyMode.SAFEGUARD_STOP, "the state tells")
    until(lambda: rig.arm.motion().failed, "the motion has failed")
    rig.mock.do("safeguard", open=False)
    rig.mock.until_still()
    rig.arm.recover()
    works_again(rig)


def test_the_supervisors_kicks_meet_no_lost_link_while_the_arm_is_recovered(rig) -> None:
    """As in HOLD, where the tick goes on: a kick that fails there would end the mission."""
    set_moving(rig)
    rig.mock.do("safeguard", open=True)
    until(lambda: rig.arm.motion().failed, "the motion has failed")
    rig.mock.do("safeguard", open=False)
    rig.mock.until_still()
    rig.kicker.errors.clear()
    rig.arm.recover()
    works_again(rig)
    assert not rig.kicker.errors


def test_a_speed_slider_at_zero_is_no_fault_but_said(rig) -> None:
    motion = set_moving(rig)
    rig.mock.do("slider", fraction=0.0)
    rig.mock.until_still()
    until(lambda: rig.arm.state().speed_scaling == 0.0, "the state tells")
    progress = rig.arm.motion()
    assert progress.running
    assert "slider" in progress.detail
    rig.arm.stop()
    rig.mock.do("slider", fraction=1.0)
    rig.mock.until_still()
    assert rig.finish(motion).failed


# --- this process ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_host_that_dies_or_hangs_leaves_an_arm_that_stands_still(rig, number) -> None:
    rig.arm.close()
    host, pid = host_process(rig.mock)
    try:
        until(lambda: not rig.mock.still(), "the arm moves")
        host.send_signal(number)
        rig.mock.until_still()
        if number == signal.SIGKILL:
            until(lambda: gone(pid), "its worker has ended too")
    finally:
        host.kill()
        host.communicate()
