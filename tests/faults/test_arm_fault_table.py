"""The table of faults, row by row, on the real client library: what the driver reports, how soon, and that the emulated
arm stands still afterwards, refuses to go on by itself, and works again after what an operator does.

Times are the host's, from the fault to the report, with room for a busy machine; ``make bench`` measures them.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import (
    ControlLinkLostError,
    ForeignProgramError,
    FrozenStateError,
    ProgramStoppedError,
    SafetyStopError,
    StateLinkLostError,
    UnreachableError,
)
from drivers.arm.ur import UrArm
from drivers.arm.worker_client import KICK_S
from drivers.base import Compliance, DriverError, LinkOpenError, SafetyMode
from perception.geometry import Pose
from tests.arm_rig import WATCHDOG_S, Rig, settings, until

DOWN = np.array([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
BUSY_S = 2.0
"""What a busy machine may add to any time here."""
PATIENT_S = 10.0
"""How long an operator waits for the dashboard."""


# --- what the arm is doing when the fault strikes ---------------------------------------------------------------------


def straight(rig: Rig) -> None:
    rig.arm.move_linear(rig.arm.state().T_base_tcp.moved([0.0, 0.0, -0.2]), 0.03, 0.5)
    rig.until_moving()


def joints(rig: Rig) -> None:
    rig.arm.move_joints(rig.arm.state().T_base_tcp.moved([0.0, 0.0, -0.2]), 0.1, 0.5)
    rig.until_moving()


def velocity(rig: Rig) -> None:
    rig.arm.move_velocity(DOWN, 0.5)
    rig.until_moving()


def force(rig: Rig) -> None:
    selection, wrench = (False, False, True, False, False, False), (0.0, 0.0, 10.0, 0.0, 0.0, 0.0)
    rig.arm.comply(Compliance(rig.arm.state().T_base_tcp, selection, wrench, (0.02,) * 6))
    rig.until_moving()


# --- the faults -------------------------------------------------------------------------------------------------------


def control(action: str, **arguments: object) -> Callable[[Rig], None]:
    return lambda rig: void(rig.mock.do(action, **arguments))


def worker(number: signal.Signals) -> Callable[[Rig], None]:
    return lambda rig: os.kill(rig.arm._links.worker.pid, number)


def no_kicks(rig: Rig) -> None:
    rig.kicker.pause()


def frozen(rig: Rig) -> None:
    rig.mock.do("freeze", seconds=3.0)
    until(lambda: not rig.arm._links.fresh, "state is stale")
    rig.kicker.pause()  # as the supervisor does with stale state


def void(_: object) -> None: ...


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    doing: Callable[[Rig], None]
    fault: Callable[[Rig], None]
    error: type[DriverError] | tuple[type[DriverError], ...]
    """What the next command says."""
    within_s: float
    """From the fault to the report."""
    recovery_refused: type[LinkOpenError] | None = None
    """Why software alone cannot go on."""


ENDED = (ProgramStoppedError, ControlLinkLostError)
"""A script that ends between its answer and the library's acknowledgement leaves the library waiting in its
next call; the worker is then given up for hung."""
SAFETY_S = 0.5
STOP = SafetyStopError
ROWS = {
    "protective stop, straight motion": Row(straight, control("protective_stop"), ProgramStoppedError, SAFETY_S, STOP),
    "protective stop, joint motion": Row(joints, control("protective_stop"), ProgramStoppedError, SAFETY_S, STOP),
    "protective stop, velocity": Row(velocity, control("protective_stop"), ProgramStoppedError, SAFETY_S, STOP),
    "protective stop, force mode": Row(force, control("protective_stop"), ProgramStoppedError, SAFETY_S, STOP),
    "emergency stop, straight motion": Row(straight, control("estop"), ProgramStoppedError, SAFETY_S, STOP),
    "emergency stop, force mode": Row(force, control("estop"), ProgramStoppedError, SAFETY_S, STOP),
    "safeguard stop, velocity": Row(velocity, control("safeguard", open=True), ProgramStoppedError, SAFETY_S, STOP),
    "safety violation": Row(straight, control("safety", mode="VIOLATION"), ProgramStoppedError, SAFETY_S, STOP),
    "safety system's fault": Row(velocity, control("safety", mode="FAULT"), ProgramStoppedError, SAFETY_S, STOP),
    "program stopped on the pendant": Row(straight, control("stop"), ENDED, SAFETY_S + KICK_S),
    "no kicks, straight motion": Row(straight, no_kicks, ENDED, WATCHDOG_S + SAFETY_S),
    "no kicks, velocity": Row(velocity, no_kicks, ENDED, WATCHDOG_S + SAFETY_S),
    "no kicks, force mode": Row(force, no_kicks, ENDED, WATCHDOG_S + SAFETY_S),
    "worker crashes, joint motion": Row(joints, worker(signal.SIGSEGV), ControlLinkLostError, 0.1),
    "worker killed, velocity": Row(velocity, worker(signal.SIGKILL), ControlLinkLostError, 0.1),
    "worker hangs, force mode": Row(force, worker(signal.SIGSTOP), ControlLinkLostError, 0.1),
    "RTDE link reset, straight motion": Row(straight, control("drop", link="rtde"), StateLinkLostError, 0.2),
    "RTDE link reset, velocity": Row(velocity, control("drop", link="rtde"), StateLinkLostError, 0.2),
    "every connection reset": Row(velocity, control("drop", link="all"), StateLinkLostError, 0.2),
    "every port closed": Row(straight, control("down", link="all"), StateLinkLostError, 0.2),
    "data frozen for 2.5 s and more": Row(velocity, frozen, FrozenStateError, 1.2),
}


@pytest.fixture(scope="module")
def shared() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


@pytest.fixture
def rig(shared: Rig) -> Iterator[Rig]:
    """The one rig; afterwards everything is put in order as an operator would."""
    yield shared
    put_in_order(shared)
    shared.arm.recover()
    shared.kicker.resume()
    assert not shared.finish(shared.arm.move_joints(shared.home, 1.0, 2.0)).failed


def put_in_order(rig: Rig) -> None:
    """What an operator does at the pendant, and a network that is repaired."""
    mock = rig.mock
    mock.do("freeze", seconds=0.0)
    mock.do("up", link="all")
    mock.do("remote", on=True)
    mock.do("release_estop")
    mock.do("safety", mode="NORMAL")
    with Dashboard(mock.host, PATIENT_S) as dashboard:
        for command in ("stop", "power on", "brake release"):
            dashboard.ask(command)
        until(lambda: dashboard.robot_mode() == "RUNNING", "the controller is ready")


def reported(rig: Rig, error: type[DriverError] | tuple[type[DriverError], ...]) -> bool:
    """Whether the next command is refused for this reason."""
    try:
        rig.arm.state()
        rig.arm.zero_force_sensor()
    except error:
        return True
    except DriverError:
        return False  # such as: the arm still moves; or the other link's loss, a moment earlier
    return False


@pytest.mark.parametrize("name", ROWS)
def test_row(rig: Rig, name: str) -> None:
    row = ROWS[name]
    row.doing(rig)
    struck = time.monotonic()
    row.fault(rig)
    until(lambda: reported(rig, row.error), "the fault is reported", row.within_s + BUSY_S)
    assert time.monotonic() - struck < row.within_s + BUSY_S
    rig.mock.until_still()
    assert not rig.arm.motion().running
    with pytest.raises(row.error) as caught:
        rig.arm.move_velocity(DOWN, 0.5)
    assert caught.value.cause and caught.value.remedy
    if row.recovery_refused is not None:
        with pytest.raises(row.recovery_refused):
            rig.arm.recover()
        assert rig.mock.state()["safety"] != "NORMAL", "software releases nothing"
    rig.kicker.resume()
    put_in_order(rig)
    with Dashboard(rig.mock.host) as dashboard:
        dashboard.ask("play")
    rig.mock.until_still()  # nothing of the old motion goes on


# --- rows without a fault in motion -----------------------------------------------------------------------------------


def test_an_unlock_within_five_seconds_is_refused_and_later_granted(rig: Rig) -> None:
    straight(rig)
    rig.mock.do("protective_stop")
    struck = rig.mock.state()["time_s"]
    with Dashboard(rig.mock.host) as dashboard:
        assert dashboard.ask("unlock protective stop").startswith("Cannot unlock")
        until(lambda: rig.mock.state()["time_s"] > struck + 5.1, "five seconds pass")
        assert dashboard.ask("unlock protective stop") == "Protective stop releasing"
    until(lambda: rig.arm.state().safety is SafetyMode.NORMAL, "the stop is released")
    with pytest.raises(ProgramStoppedError):  # every command, until recovered
        rig.arm.move_velocity(DOWN, 0.5)
    rig.mock.until_still()


def test_right_after_recovery_a_motion_is_taken(rig: Rig) -> None:
    rig.mock.do("stop")
    until(lambda: reported(rig, ENDED), "the end of the script is reported")
    rig.arm.recover()
    progress = rig.finish(rig.arm.move_linear(rig.arm.state().T_base_tcp.moved([0.0, 0.0, -0.02]), 0.1, 0.5))
    assert not progress.failed, progress.detail


def test_opening_while_stopped_is_refused_sooner_than_the_library_would(rig: Rig) -> None:
    rig.mock.do("protective_stop")
    begun = time.monotonic()
    with pytest.raises(SafetyStopError):
        UrArm(settings(rig.mock.host)).open()
    assert time.monotonic() - begun < 5.0
    rig.mock.until_still()


@pytest.mark.parametrize("command", ["move_linear", "move_joints"])
def test_a_pose_without_a_solution_is_refused_and_the_script_lives(rig: Rig, command: str) -> None:
    far = Pose(np.eye(3), np.array([3.0, 0.0, 0.5]))
    begun = time.monotonic()
    with pytest.raises(UnreachableError):
        getattr(rig.arm, command)(far, 0.1, 0.5)
    assert time.monotonic() - begun < BUSY_S
    assert rig.mock.state()["program"] == "rtde_control"
    rig.mock.until_still()


def test_a_motion_longer_than_the_watchdogs_period_is_kicked_to_its_end(rig: Rig) -> None:
    begun = rig.mock.state()["time_s"]
    progress = rig.finish(rig.arm.move_linear(rig.arm.state().T_base_tcp.moved([0.0, 0.0, -0.08]), 0.04, 0.5))
    assert not progress.failed, progress.detail
    assert rig.mock.state()["time_s"] - begun > 3.0 * WATCHDOG_S


def test_a_velocity_that_leads_out_of_reach_ends_in_a_report(rig: Rig) -> None:
    outwards = rig.arm.state().T_base_tcp.translation * np.array([1.0, 1.0, 0.0])
    speed = 0.4 * outwards / np.linalg.norm(outwards)
    rig.arm.move_velocity(np.concatenate([speed, np.zeros(3)]), 1.0)
    rig.until_moving()
    until(lambda: reported(rig, ENDED), "the end of the script is reported", 20.0)
    rig.mock.until_still()


def test_a_second_driver_on_the_same_robot_is_refused_and_the_first_goes_on(rig: Rig) -> None:
    straight(rig)
    with pytest.raises(ForeignProgramError):
        UrArm(settings(rig.mock.host)).open()
    assert rig.arm.motion().running
    assert rig.arm.state().moving
    rig.arm.stop()
    rig.mock.until_still()


def test_local_mode_ends_the_network_control_at_the_next_start(rig: Rig) -> None:
    rig.mock.do("remote", on=False)
    rig.mock.do("stop")
    until(lambda: reported(rig, ENDED), "the end of the script is reported")
    with pytest.raises(LinkOpenError, match="local mode"):
        rig.arm.recover()
    rig.mock.until_still()
