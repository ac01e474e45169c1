"""What is checked before the arm's links are opened: that it is the right robot, and in a state to be driven."""

from __future__ import annotations

import logging

from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import (
    ArmAbsentError,
    ArmNotReadyError,
    ArmVersionError,
    ForeignProgramError,
    LocalModeError,
    ProgramStartError,
    RegistersInUseError,
    SafetyStopError,
    WrongModelError,
    WrongSerialError,
)
from drivers.arm.rtde_stream import controller_version
from drivers.arm.settings import UrSettings
from drivers.base import Clock, LinkLostError, LinkOpenError, ProtocolError

log = logging.getLogger(__name__)

OLDEST = (5, 6)
"""First version whose dashboard knows remote control and whose RTDE knows the payload."""
UPPER_RANGE_BROKEN = (5, 23)
"""From here on ur_rtde 1.6 loses the offset of the upper register range."""
SAFE = ("NORMAL", "REDUCED")
SAME_ROBOT = {"ur7": "ur5", "ur12": "ur10"}
"""Renamed models that a controller may still report by their old name."""
PROGRAM_END_S = 1.0


def check_robot(settings: UrSettings, clock: Clock) -> None:
    """Raise the LinkOpenError that names what is wrong, or leave the controller ready for the control script."""
    version = controller_version(settings.host, settings.connect_timeout_s)
    check_version(version[:2], settings.upper_registers)
    try:
        with Dashboard(settings.host, settings.connect_timeout_s) as dashboard:
            _check_identity(dashboard, settings)
            _check_state(dashboard)
            _check_program(dashboard, settings.stop_running_program, clock)
    except LinkLostError as error:
        raise ArmAbsentError(str(error)) from error
    except ProtocolError as error:
        raise LinkOpenError(str(error)) from error


def check_version(version: tuple[int, ...], upper_registers: bool) -> None:
    """Refuse versions that the driver or the client library cannot serve."""
    text = ".".join(map(str, version))
    if version < OLDEST or version[0] != OLDEST[0]:
        raise ArmVersionError(f"the controller runs PolyScope {text}")
    if upper_registers and version >= UPPER_RANGE_BROKEN:
        raise ArmVersionError(
            f"the upper register range does not work with ur_rtde on PolyScope {text}",
            remedy="Use the lower register range; disable EtherNet/IP and PROFINET if they own it.",
        )


def same_model(configured: str, reported: str) -> bool:
    """Whether the dashboard's name (UR10) is the configured model's (ur10e)."""
    mine, theirs = (name.strip().lower().removesuffix("e") for name in (configured, reported))
    return theirs in (mine, SAME_ROBOT.get(mine))


def _check_identity(dashboard: Dashboard, settings: UrSettings) -> None:
    model = dashboard.model()
    if not same_model(settings.model, model):
        raise WrongModelError(f"the robot at {settings.host} is a {model}, not a {settings.model}")
    if settings.serial is not None and dashboard.serial() != settings.serial:
        raise WrongSerialError(f"the robot at {settings.host} has serial number {dashboard.serial()}")


def _check_state(dashboard: Dashboard) -> None:
    safety = dashboard.safety_status()
    if safety not in SAFE:
        raise SafetyStopError(f"the robot's safety status is {safety}")
    mode = dashboard.robot_mode()
    if mode != "RUNNING":
        raise ArmNotReadyError(f"the robot's mode is {mode}, not RUNNING")
    if not dashboard.remote_control():
        raise LocalModeError("the robot is in local mode")


def _check_program(dashboard: Dashboard, stop_it: bool, clock: Clock) -> None:
    """Another program must not run. A script that a dead portdock left behind is ended by its watchdog: wait for it."""
    deadline = clock.now_s() + PROGRAM_END_S
    while dashboard.program_running():
        if stop_it:
            log.warning("a program is running on the robot's controller and is stopped")
            dashboard.stop()
            stop_it = False
        elif clock.now_s() > deadline:
            raise ForeignProgramError("a program is running on the robot's controller")
        clock.sleep(0.05)


def start_error(reason: str) -> LinkOpenError:
    """The typed error behind what ur_rtde said when its control interface could not be made."""
    if "already in use" in reason:
        return RegistersInUseError("another client owns the robot's RTDE registers")
    if "remote control" in reason:
        return LocalModeError("the robot is in local mode")
    if "Failed to start control script" in reason:
        return ProgramStartError("the robot does not run the control script")
    if "Could not connect" in reason:
        return ArmAbsentError("the robot's controller refuses the control link")
    return LinkOpenError(f"the arm's control link cannot be opened: {reason.strip().splitlines()[-1][:200]}")
