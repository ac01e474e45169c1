"""Fault codes with cause and remedy, and the outcome of a mission.

A code is stable: reports, recordings, tests and site tooling refer to it. The cause says what portdock saw, the remedy
what a person does about it.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Literal

from controller.states import Event
from perception.errors import PortdockError


class FaultCode(enum.Enum):
    """Every way in which a mission can end otherwise than asked."""

    PORT_NOT_FOUND = "port-not-found"
    PLAN_REFUSED = "plan-refused"
    SCAN_FAILED = "scan-failed"
    INSERTION_BLOCKED = "insertion-blocked"
    NOT_MATED = "not-mated"
    NOT_CHARGING = "not-charging"
    PLUG_INSERTED_AT_START = "plug-inserted-at-start"
    AXIS_UNKNOWN = "axis-unknown"
    RELEASE_FAILED = "release-failed"
    WITHDRAWAL_BLOCKED = "withdrawal-blocked"
    FORCE_LIMIT = "force-limit"
    ARM_LINK_LOST = "arm-link-lost"
    SCANNER_LINK_LOST = "scanner-link-lost"
    CHARGER_LINK_LOST = "charger-link-lost"
    ARM_NOT_READY = "arm-not-ready"
    PROTECTIVE_STOP = "protective-stop"
    SAFEGUARD_STOP = "safeguard-stop"
    EMERGENCY_STOP = "emergency-stop"
    SAFETY_SYSTEM = "safety-system"
    CHARGER_FAULT = "charger-fault"
    CHARGER_REJECTED = "charger-rejected"
    DEADLINE = "deadline"
    ABORTED = "aborted"
    RESET_REFUSED = "reset-refused"
    GATE_REFUSED = "gate-refused"
    MOTION_FAILED = "motion-failed"
    SUPERVISOR_STALLED = "supervisor-stalled"
    PERCEPTION_FAILED = "perception-failed"
    INTERNAL = "internal"


REMEDIES: dict[FaultCode, str] = {
    FaultCode.PORT_NOT_FOUND: "Look at the report's reasons; check cover, port type and where the car stands.",
    FaultCode.PLAN_REFUSED: "Park the car within the arm's reach, or change scan.viewpoints, where approaches start.",
    FaultCode.SCAN_FAILED: "Check the scanner's cable and window; look at the lost-profile counters in the report.",
    FaultCode.INSERTION_BLOCKED: "Look into the port for an obstacle; compare the contact offsets in the report.",
    FaultCode.NOT_MATED: "Check the plug's proximity contact and latch.",
    FaultCode.NOT_CHARGING: "See the charger's own fault code and the car's display.",
    FaultCode.PLUG_INSERTED_AT_START: "Run `portdock undock`, or take the plug out by hand, then `portdock reset`.",
    FaultCode.AXIS_UNKNOWN: "Take the plug out by hand (freedrive), move the arm clear of the vehicle, then reset.",
    FaultCode.RELEASE_FAILED: "Unlock the plug at the car or charger; never pull while the contactor is closed.",
    FaultCode.WITHDRAWAL_BLOCKED: "Unlock the plug by hand and free it; the arm will not pull harder by itself.",
    FaultCode.FORCE_LIMIT: "Check plug and port for damage before the next attempt.",
    FaultCode.ARM_LINK_LOST: "Check the robot's network cable and power; then reset.",
    FaultCode.SCANNER_LINK_LOST: "Check the scanner's cable and power; then reset.",
    FaultCode.CHARGER_LINK_LOST: "Check the CAN cable, termination and the charger's power; then reset.",
    FaultCode.ARM_NOT_READY: "Power on the arm, release its brakes, switch it to remote control; then reset.",
    FaultCode.PROTECTIVE_STOP: "Look at the arm, free it, release the protective stop on the pendant; then reset.",
    FaultCode.SAFEGUARD_STOP: "Clear the protected zone; then reset.",
    FaultCode.EMERGENCY_STOP: "Remove the danger, release the emergency stop, power the arm on; then reset.",
    FaultCode.SAFETY_SYSTEM: "Read the pendant's safety message, remove its cause, restart safety there; then reset.",
    FaultCode.CHARGER_FAULT: "See the charger's fault code; then reset.",
    FaultCode.CHARGER_REJECTED: "See the charger's state in the report; reset the charger.",
    FaultCode.DEADLINE: "See in the report which state took too long, and what it waited for.",
    FaultCode.ABORTED: "Reset when the reason for the abort is gone.",
    FaultCode.RESET_REFUSED: "Remove what is named, then reset again.",
    FaultCode.GATE_REFUSED: "See the refused command in the report; check limits and site geometry.",
    FaultCode.MOTION_FAILED: "See the arm's message; check reach, joint limits and payload.",
    FaultCode.SUPERVISOR_STALLED: "The host was too busy or suspended; check its load, then reset.",
    FaultCode.PERCEPTION_FAILED: "See the log; the scan is in the recording for replay.",
    FaultCode.INTERNAL: "Report this with the recording: it is a defect of portdock.",
}

EVENT_OF: dict[FaultCode, Event] = {
    FaultCode.ARM_LINK_LOST: Event.LINK_LOST,
    FaultCode.SCANNER_LINK_LOST: Event.LINK_LOST,
    FaultCode.CHARGER_LINK_LOST: Event.LINK_LOST,
    FaultCode.PROTECTIVE_STOP: Event.PROTECTIVE_STOP,
    FaultCode.EMERGENCY_STOP: Event.ESTOP,
    FaultCode.CHARGER_FAULT: Event.CHARGER_FAULT,
    FaultCode.DEADLINE: Event.DEADLINE,
    FaultCode.ABORTED: Event.ABORT,
}
"""The event that a fault raises; FAILED for all others."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault as it happened."""

    code: FaultCode
    detail: str = ""

    @property
    def remedy(self) -> str:
        """What a person does about it."""
        return REMEDIES[self.code]

    @property
    def event(self) -> Event:
        """What it means to the state machine."""
        return EVENT_OF.get(self.code, Event.FAILED)

    def __str__(self) -> str:
        return f"{self.code.value}: {self.detail}" if self.detail else self.code.value


class MissionFault(PortdockError):
    """Raised inside a mission step: the mission latches FAULT with this fault."""

    code = "mission-fault"

    def __init__(self, code: FaultCode, detail: str = "") -> None:
        self.fault = Fault(code, detail)
        super().__init__(str(self.fault), remedy=self.fault.remedy)


NEEDS_A_PERSON = frozenset(
    {
        FaultCode.INSERTION_BLOCKED,
        FaultCode.FORCE_LIMIT,
        FaultCode.NOT_MATED,
        FaultCode.NOT_CHARGING,
        FaultCode.PLUG_INSERTED_AT_START,
        FaultCode.AXIS_UNKNOWN,
        FaultCode.RELEASE_FAILED,
        FaultCode.WITHDRAWAL_BLOCKED,
    }
)
"""Faults that leave plug, port or lock in a state that somebody has to look at: the outcome is intervention-needed."""

OutcomeKind = Literal[
    "charged",
    "charging",
    "undocked",
    "already-docked",
    "already-undocked",
    "ready",
    "refused",
    "intervention-needed",
    "fault",
    "stopped",
]
DONE: frozenset[OutcomeKind] = frozenset(
    {"charged", "charging", "undocked", "already-docked", "already-undocked", "ready"}
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a mission ended. ``fault`` says why it did not end as asked."""

    kind: OutcomeKind
    fault: Fault | None = None

    @property
    def ok(self) -> bool:
        """Whether the mission did what was asked."""
        return self.kind in DONE

    @staticmethod
    def of(fault: Fault) -> Outcome:
        """How a mission ends that latched this fault."""
        return Outcome("intervention-needed" if fault.code in NEEDS_A_PERSON else "fault", fault)
