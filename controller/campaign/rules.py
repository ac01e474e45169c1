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


KILLED = "killed"
"""The outcome of a process that was killed: none."""
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
    "protective-stop": "the robot stops itself",
    "zone-entered": "somebody is in the protected zone for a few seconds",
    "stop": "somebody asks for a stop",
    "abort": "somebody asks for an abort",
    "arm-cut": "the robot's network cable is pulled: connections reset, ports closed",
    "arm-frozen": "the robot's controller hangs: its links stay open and silent",
    "arm-late": "the robot's controller is silent for longer than allowed, then everything comes at once",
    "arm-corrupted": "bytes of the robot's links are wrong",
    "charger-cut": "the CAN adapter is unplugged",
    "charger-frozen": "the charger hangs: its bus stays open and silent",
    "charger-late": "the charger is silent for longer than allowed, then everything comes at once",
    "charger-corrupted": "every checksum of the charger is wrong",
    "charger-repeats": "the charger repeats its last frames byte for byte",
    "scanner-cut": "the scanner's serial adapter is unplugged",
    "scanner-frozen": "the scanner hangs: its line stays open and silent",
    "scanner-late": "the scanner's bytes stop for a while, then come all at once",
    "scanner-corrupted": "many of the scanner's bytes are wrong",
    "lock-jammed": "the plug's lock no longer moves",
    "contactor-welded": "the contactor no longer opens once it is closed",
    "precharge-fails": "the charger's voltage does not rise",
    "perception-refuses": "perception cannot work on the scan",
    "worker-killed": "perception's process is killed",
    "disk-full": "the disk takes no more of the recording",
    "clock-jumps": "the computer's calendar clock is put forward by an hour",
    "host-suspended": "this process does not run for a few seconds, as on a suspended computer",
    "process-killed": "this process is killed, then started again",
}
"""The catalogue: name and what happens."""

_BEFORE_LOCATING = frozenset({_S.SELF_CHECK, _S.STAGING, _S.SCANNING, _S.LOCATING})
_PAUSABLE = frozenset({_S.STAGING, _S.SCANNING, _S.LOCATING, _S.APPROACHING})


def rule(fault: str, state: State) -> Rule:
    """The rule of one cell. Raises KeyError for a fault that is not in the catalogue."""
    if state not in STATES:
        return _impossible(NOT_ENTERED)
    match fault:
        case "emergency-stop":
            return _faults(_F.EMERGENCY_STOP)
        case "protective-stop":
            return _faults(_F.PROTECTIVE_STOP)
        case "zone-entered":
            return _goes_on() if state in _PAUSABLE else _faults(_F.SAFEGUARD_STOP)
        case "arm-cut" | "arm-frozen" | "arm-late":
            return _faults(_F.ARM_LINK_LOST)
        case "arm-corrupted":
            return _impossible("TCP hands on no damaged byte; a damaged network is a cut or a late one")
        case "charger-cut" | "charger-frozen" | "charger-late" | "charger-corrupted" | "charger-repeats":
            return Rule(Arm.BACKS_OFF if state is _S.APPROACHING else Arm.STANDS, frozenset({_F.CHARGER_LINK_LOST}))
        case "scanner-cut" | "scanner-frozen":
            return _scanner_lost(state)
        case "scanner-late":
            return _goes_on()
        case "scanner-corrupted":
            return _scanner_corrupted(state)
        case "lock-jammed":
            return _lock_jammed(state)
        case "contactor-welded" | "precharge-fails":
            return _power(fault, state)
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
        case "clock-jumps":
            return _goes_on()
        case "host-suspended":
            return _suspended(state)
        case "process-killed":
            return Rule(Arm.STANDS, kinds=frozenset({KILLED}))
    raise KeyError(fault)


def _impossible(why: str) -> Rule:
    return Rule(Arm.GOES_ON, impossible=why)


def _faults(*codes: FaultCode) -> Rule:
    return Rule(Arm.STANDS, frozenset(codes))


def _goes_on() -> Rule:
    return Rule(Arm.GOES_ON, kinds=frozenset({"charged"}))


def _scanner_lost(state: State) -> Rule:
    """A silent scanner is noticed only where it is needed: afterwards the plug goes in and out without it."""
    if state in (_S.SELF_CHECK, _S.STAGING, _S.SCANNING):
        return _faults(_F.SCANNER_LINK_LOST, _F.SCAN_FAILED)
    return _goes_on()


def _lock_jammed(state: State) -> Rule:
    """What cannot be locked is not mated; what cannot be unlocked is not pulled. Both need a person."""
    if state is _S.RETREATING:
        return _impossible("the lock is open by then, and not moved again")
    codes = {_F.RELEASE_FAILED} if state in (_S.CHARGING, _S.RELEASING) else {_F.NOT_MATED, _F.RELEASE_FAILED}
    return Rule(Arm.STANDS, frozenset({*codes, _F.WITHDRAWAL_BLOCKED}), kinds=frozenset({"intervention-needed"}))


def _power(fault: str, state: State) -> Rule:
    """The charger says so itself; it matters until power is on (pre-charge) or off (contactor)."""
    over = {_S.RETREATING} if fault == "contactor-welded" else {_S.RELEASING, _S.RETREATING}
    if state in over:
        return _goes_on()
    codes = {_F.CHARGER_FAULT, _F.RELEASE_FAILED} if fault == "contactor-welded" else {_F.CHARGER_FAULT}
    codes |= {_F.CHARGER_REJECTED, _F.NOT_CHARGING} if fault == "precharge-fails" else set()
    return Rule(Arm.STANDS, frozenset(codes), kinds=frozenset({"fault", "intervention-needed"}))


def _suspended(state: State) -> Rule:
    """Who wakes late must not go on moving; the charger has wound a charge down meanwhile, by its own supervision."""
    lost = {_F.SUPERVISOR_STALLED, _F.CHARGER_FAULT}
    if state in (_S.CHARGING, _S.RELEASING):
        lost |= {_F.NOT_CHARGING}
    at_rest = {"charged"} if state in (_S.SELF_CHECK, _S.LOCATING, _S.RELEASING) else set()
    return Rule(Arm.STANDS, frozenset(lost), kinds=frozenset({"fault", "intervention-needed", *at_rest}))


def _scanner_corrupted(state: State) -> Rule:
    """Damaged profiles are thrown away and the sweep repeated, until there is no viewpoint left to try from."""
    if state in (_S.SELF_CHECK, _S.STAGING, _S.SCANNING):
        codes = frozenset({_F.SCAN_FAILED, _F.PORT_NOT_FOUND, _F.SCANNER_LINK_LOST})
        return Rule(Arm.STANDS, codes, kinds=frozenset({"fault", "refused"}))
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
