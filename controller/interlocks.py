"""What forbids going on, judged from one look at everything: pure rules that the supervisor's tick asks each time."""

from __future__ import annotations

from dataclasses import dataclass

from controller.faults import Fault, FaultCode
from controller.states import State
from drivers.base import ArmState, ChargerState, ChargerStatus, RobotMode, SafetyMode

PAUSABLE_STATES = frozenset({State.STAGING, State.SCANNING, State.LOCATING, State.APPROACHING, State.HOLD})
"""Before contact a person in the zone or a speed slider at 0 only pauses the mission."""

MOVING_STATES = frozenset(
    {State.STAGING, State.SCANNING, State.APPROACHING, State.INSERTING, State.VERIFYING, State.RETREATING}
)


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What one tick saw. A missing value carries the fault that explains it."""

    state: State
    arm: ArmState | None
    arm_problem: str
    charger: ChargerStatus | None
    charger_problem: str
    scanner_up: bool
    scanner_problem: str
    overdue: str
    """What the state's deadline says; empty while there is time."""
    late_s: float = 0.0
    """How late this tick came."""
    stall_s: float = 0.5
    """A tick later than this means that the host was suspended or starved."""


def assess(seen: Snapshot, without_charger: bool = False) -> Fault | None:
    """The first reason not to go on, most urgent first; ``without_charger`` its silence is none. Pure."""
    if seen.state in (State.OFFLINE, State.FAULT):
        return None
    if seen.arm is not None and (fault := _arm_fault(seen.arm, seen.state)):
        return fault
    if seen.charger is not None and (fault := _charger_fault(seen.charger, seen.state)):
        return fault
    if seen.late_s > seen.stall_s and (seen.state in MOVING_STATES or seen.arm is None or seen.charger is None):
        return Fault(FaultCode.SUPERVISOR_STALLED, f"a tick came {seen.late_s * 1000:.0f} ms late")
    if seen.arm is None:
        return Fault(FaultCode.ARM_LINK_LOST, seen.arm_problem)
    if seen.charger is None and not without_charger:
        return Fault(FaultCode.CHARGER_LINK_LOST, seen.charger_problem)
    if not seen.scanner_up and seen.state in (State.STAGING, State.SCANNING):
        return Fault(FaultCode.SCANNER_LINK_LOST, seen.scanner_problem)
    if seen.overdue:
        return Fault(FaultCode.DEADLINE, seen.overdue)
    return None


def pause_reason(seen: Snapshot) -> str | None:
    """Why the mission should wait in HOLD, where that is possible. Pure."""
    if seen.arm is None or seen.state not in PAUSABLE_STATES:
        return None
    if seen.arm.safety is SafetyMode.SAFEGUARD_STOP:
        return "somebody is in the protected zone"
    if seen.arm.speed_scaling <= 0.0 and seen.arm.program_running:
        return "the speed slider is at 0"
    return None


def _arm_fault(arm: ArmState, state: State) -> Fault | None:
    match arm.safety:
        case SafetyMode.ROBOT_ESTOP | SafetyMode.SYSTEM_ESTOP:
            return Fault(FaultCode.EMERGENCY_STOP, "pressed at the robot")
        case SafetyMode.PROTECTIVE_STOP:
            return Fault(FaultCode.PROTECTIVE_STOP, "the robot stopped itself")
        case SafetyMode.SAFEGUARD_STOP if state not in PAUSABLE_STATES:
            return Fault(FaultCode.SAFEGUARD_STOP, "the protected zone was entered")
        case SafetyMode.VIOLATION | SafetyMode.FAULT | SafetyMode.RECOVERY:
            return Fault(FaultCode.SAFETY_SYSTEM, f"the robot's safety system stopped it: {arm.safety.name}")
    if arm.mode is not RobotMode.RUNNING and state is not State.SELF_CHECK:
        return Fault(FaultCode.ARM_NOT_READY, f"robot mode {arm.mode.name}")
    return None


def _charger_fault(charger: ChargerStatus, state: State) -> Fault | None:
    if charger.estop:
        return Fault(FaultCode.EMERGENCY_STOP, "pressed at the charger")
    if charger.state is ChargerState.ESTOP and state is not State.SELF_CHECK:  # where a reset ends what is latched
        return Fault(FaultCode.EMERGENCY_STOP, "latched at the charger")
    if charger.state is ChargerState.FAULT and state is not State.SELF_CHECK:  # which looks for a plug first
        return Fault(FaultCode.CHARGER_FAULT, f"charger fault code {charger.fault_code}")
    if charger.motion_inhibit and state in MOVING_STATES:
        return Fault(FaultCode.CHARGER_FAULT, "the charger inhibits motion")
    return None
