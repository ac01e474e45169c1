"""What must come out when a fault meets a state: written down before anything runs, one rule for each cell.

States are those that a nominal docking cycle enters; the fault is made on entry. A cell without a rule's outcome is
*impossible*, and says why.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from controller.faults import FaultCode
from controller.states import State

_F, _S = FaultCode, State

STATES = (
    *(_S.SELF_CHECK, _S.STAGING, _S.SCANNING, _S.LOCATING, _S.APPROACHING),
    *(_S.INSERTING, _S.VERIFYING, _S.CHARGING, _S.RELEASING, _S.RETREATING),
)
NOT_ENTERED = "a nominal cycle does not stay in this state"


class Arm(enum.Enum):
    """What the arm does after the fault."""

    STANDS = "stands"
    """Within ``STAND_M`` of where it is ``STOPPING_S`` after FAULT was entered."""
    RETREATS = "retreats"
    """It ends clear of the vehicle, out along its axis if it was in contact."""
    GOES_ON = "goes on"
    """The fault does not concern the motion."""
    BACKS_OFF = "backs off, then stands"
    """Before contact, out on the axis of approach (``back_off``), before FAULT is entered."""


STAND_M = 0.002
STOPPING_S = 0.5


@dataclass(frozen=True, slots=True)
class Rule:
    """What one cell must come to."""

    arm: Arm
    codes: frozenset[FaultCode] = frozenset()
    """The fault codes that name the cause; empty: the mission must end without a fault."""
    kinds: frozenset[str] = frozenset({"fault"})
    """Outcomes that are right."""
    whole_recording: bool = True
    """Whether the recording goes on to the end; a full disk ends it, readably."""
    impossible: str = ""
    """Why this cell cannot be made; empty if it can."""


FAULTS: dict[str, str] = {
    "emergency-stop": "the emergency stop circuit opens",
    "arm-frozen": "the robot's controller hangs: its links stay open and silent",
    "charger-frozen": "the charger hangs: its bus stays open and silent",
    "scanner-frozen": "the scanner hangs: its line stays open and silent",
    "stop": "somebody asks for a stop",
    "abort": "somebody asks for an abort",
    "perception-refuses": "perception cannot work on the scan",
    "worker-killed": "perception's process is killed",
    "disk-full": "the disk takes no more of the recording",
}
"""The catalogue: name and what happens."""

_BEFORE_LOCATING = frozenset({_S.SELF_CHECK, _S.STAGING, _S.SCANNING, _S.LOCATING})
_BEFORE_CONTACT = _BEFORE_LOCATING | {_S.APPROACHING}


def rule(fault: str, state: State) -> Rule:
    """The rule of one cell. Raises KeyError for a fault that is not in the catalogue."""
    if state not in STATES:
        return _impossible(NOT_ENTERED)
    match fault:
        case "emergency-stop":
            return _faults(_F.EMERGENCY_STOP)
        case "arm-frozen":
            return _faults(_F.ARM_LINK_LOST)
        case "charger-frozen":
            return Rule(Arm.BACKS_OFF if state is _S.APPROACHING else Arm.STANDS, frozenset({_F.CHARGER_LINK_LOST}))
        case "scanner-frozen":
            return _scanner_frozen(state)
        case "stop":
            return _stop(state)
        case "abort":
            return _faults(_F.ABORTED)
        case "perception-refuses":
            return _perception(state, "a cloud is located in once")
        case "worker-killed":
            return _perception(state, "")
        case "disk-full":
            return Rule(Arm.GOES_ON, kinds=frozenset({"charged"}), whole_recording=False)
    raise KeyError(fault)


def _impossible(why: str) -> Rule:
    return Rule(Arm.GOES_ON, impossible=why)


def _faults(*codes: FaultCode) -> Rule:
    return Rule(Arm.STANDS, frozenset(codes))


def _goes_on() -> Rule:
    return Rule(Arm.GOES_ON, kinds=frozenset({"charged"}))


def _scanner_frozen(state: State) -> Rule:
    """A silent scanner is noticed only where it is needed: afterwards the plug goes in and out without it."""
    if state in (_S.SELF_CHECK, _S.STAGING, _S.SCANNING):
        return _faults(_F.SCANNER_LINK_LOST, _F.SCAN_FAILED)
    return _goes_on()


def _stop(state: State) -> Rule:
    """A stop finishes safely; where a cycle is as good as over it may simply end."""
    if state is _S.SELF_CHECK:
        return Rule(Arm.GOES_ON, kinds=frozenset({"stopped"}))
    late = state in (_S.RELEASING, _S.RETREATING)
    return Rule(Arm.RETREATS, kinds=frozenset({"stopped", "charged"} if late else {"stopped"}))


def _perception(state: State, only_locating: str) -> Rule:
    """Perception is needed until the port is located; what becomes of it later does not concern the mission."""
    if only_locating and state is not _S.LOCATING:
        return _impossible(only_locating)
    return _faults(_F.PERCEPTION_FAILED) if state in _BEFORE_LOCATING else _goes_on()
