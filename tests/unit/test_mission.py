"""The mission on stand-ins: the docking procedure, its escalation, and every fault in every state."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from controller.durable import recall_insertion
from controller.faults import FaultCode
from drivers.base import ChargerRequest, ChargerState, LinkLostError, Proximity, RobotMode, SafetyMode
from perception.errors import PortdockError
from tests.unit.mission_rig import MATED_DEPTH_M, Rig


class MotionRefused(PortdockError):
    """What a driver raises for a motion that the robot does not take."""

    code = "motion-refused"
    default_remedy = "Look at the robot."


CYCLE = [
    "SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING", "CHARGING",
    "RELEASING", "RETREATING", "READY",
]  # fmt: skip
LONG_STATES = ["SCANNING", "LOCATING", "INSERTING", "CHARGING"]
"""States that last long enough on stand-ins for something to happen inside them."""


def test_a_good_cycle_passes_every_state_and_ends_charged(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    outcome = rig.run()
    assert (outcome.kind, outcome.fault) == ("charged", None)
    assert rig.watch.states == CYCLE
    assert rig.decisions.refused == []


def test_power_is_wanted_only_after_the_lock_and_gone_before_it_opens(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.run()
    order = [r for r in rig.charger.requests if r is not ChargerRequest.RELEASE]
    assert order == [
        ChargerRequest.RESERVE,
        ChargerRequest.UNLOCK_DOCK,
        ChargerRequest.LOCK_PLUG,
        ChargerRequest.ENABLE_POWER,
        ChargerRequest.STOP_POWER,
        ChargerRequest.UNLOCK_PLUG,
    ]


@pytest.mark.parametrize("session", [ChargerState.READY, ChargerState.FINISHED])
def test_a_charger_that_missed_the_end_of_the_session_before_is_released_from_it_first(
    tmp_path: Path, session: ChargerState
) -> None:
    """It was silent when the mission before ended in a fault: it would reject the reservation for ever."""
    rig = Rig(tmp_path)
    rig.charger.session = session
    assert rig.run().kind == "charged"
    assert rig.charger.requests[:2] == [ChargerRequest.RELEASE, ChargerRequest.RESERVE]


def test_the_insertion_axis_is_on_disk_before_contact_and_gone_when_the_plug_is_out(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    stored = []
    rig.at("INSERTING", lambda: stored.append(recall_insertion(tmp_path)))
    rig.run()
    assert stored[0] is not None and stored[0].T_base_port.distance_to(rig.arm.T_base_port) == 0.0
    assert recall_insertion(tmp_path) is None


def test_a_refused_scan_leads_to_the_next_viewpoint(tmp_path: Path) -> None:
    rig = Rig(tmp_path, accepted=[False, True])
    assert rig.run().kind == "charged"
    assert rig.watch.states.count("SCANNING") == 2


def test_without_a_port_the_mission_is_refused_and_the_arm_never_approaches(tmp_path: Path) -> None:
    rig = Rig(tmp_path, accepted=[False])
    outcome = rig.run()
    assert outcome.kind == "refused" and outcome.fault is not None
    assert outcome.fault.code is FaultCode.PORT_NOT_FOUND and "no rim" in outcome.fault.detail
    assert "APPROACHING" not in rig.watch.states and "move_linear" not in rig.arm.moves
    assert rig.watch.states.count("SCANNING") == len(rig.config.scan.viewpoints)


def test_a_blocked_port_is_tried_to_the_last_rung_then_a_person_is_asked_for(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.arm.stop_depth_m = 0.008
    outcome = rig.run()
    assert outcome.kind == "intervention-needed" and outcome.fault is not None
    assert outcome.fault.code is FaultCode.INSERTION_BLOCKED and outcome.fault.remedy
    assert rig.watch.states.count("INSERTING") == rig.watch.states.count("RETREATING") == 3
    assert "VERIFYING" not in rig.watch.states
    assert all(i.contact.along_m == pytest.approx(MATED_DEPTH_M - 0.008, abs=1e-5) for i in rig.watch.insertions)


def test_a_blocked_port_that_is_not_found_again_is_still_called_blocked(tmp_path: Path) -> None:
    rig = Rig(tmp_path, accepted=[True, False])
    rig.arm.stop_depth_m = 0.008
    outcome = rig.run()
    assert outcome.kind == "intervention-needed" and outcome.fault is not None
    assert outcome.fault.code is FaultCode.INSERTION_BLOCKED
    assert rig.watch.states.count("INSERTING") == 1


def test_a_lock_that_jams_on_its_way_shut_is_not_pulled_against_and_a_person_is_asked_for(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.charger.lock_stops_halfway = True
    outcome = rig.run()
    assert outcome.kind == "intervention-needed"
    assert outcome.fault is not None and outcome.fault.code is FaultCode.RELEASE_FAILED
    assert "the plug's lock is fault" in outcome.fault.detail
    assert rig.arm.depth_m == pytest.approx(MATED_DEPTH_M, abs=1e-5)


def test_a_plug_that_the_charger_does_not_lock_is_not_mated(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.charger.lock_jams = True
    outcome = rig.run()
    assert outcome.kind == "intervention-needed" and outcome.fault is not None
    assert outcome.fault.code is FaultCode.NOT_MATED
    assert ChargerRequest.ENABLE_POWER not in rig.charger.requests


def test_charging_is_a_measured_current_not_a_commands_echo(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.charger.gives_current = False
    outcome = rig.run()
    assert outcome.kind == "intervention-needed" and outcome.fault is not None
    assert outcome.fault.code is FaultCode.NOT_CHARGING
    assert rig.watch.states[-4:] == ["CHARGING", "RELEASING", "RETREATING", "READY"]


def test_a_plug_found_at_the_start_is_never_moved(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.charger.forced = {"proximity": Proximity.INSERTED}
    outcome = rig.run()
    assert outcome.fault is not None and outcome.fault.code is FaultCode.PLUG_INSERTED_AT_START
    assert set(rig.arm.moves) <= {"stop"}


def test_a_motion_that_the_arm_gives_up_is_a_fault(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.arm.motion_fails = True
    outcome = rig.run()
    assert outcome.fault is not None and outcome.fault.code is FaultCode.MOTION_FAILED


# --- a fault in every state -------------------------------------------------------------------------------------------

FAULTS: dict[str, tuple[Callable[[Rig], None], FaultCode]] = {
    "arm link cut": (lambda rig: setattr(rig.arm, "lost", True), FaultCode.ARM_LINK_LOST),
    "charger silent": (lambda rig: setattr(rig.charger, "lost", True), FaultCode.CHARGER_LINK_LOST),
    "protective stop": (
        lambda rig: setattr(rig.arm, "safety", SafetyMode.PROTECTIVE_STOP),
        FaultCode.PROTECTIVE_STOP,
    ),
    "robot e-stop": (lambda rig: setattr(rig.arm, "safety", SafetyMode.ROBOT_ESTOP), FaultCode.EMERGENCY_STOP),
    "safety violation": (lambda rig: setattr(rig.arm, "safety", SafetyMode.VIOLATION), FaultCode.SAFETY_SYSTEM),
    "charger e-stop": (lambda rig: rig.charger.forced.update(estop=True), FaultCode.EMERGENCY_STOP),
    "charger fault": (
        lambda rig: rig.charger.forced.update(state=ChargerState.FAULT),
        FaultCode.CHARGER_FAULT,
    ),
    "arm powered off": (lambda rig: setattr(rig.arm, "mode", RobotMode.POWER_OFF), FaultCode.ARM_NOT_READY),
    "abort": (lambda rig: rig.supervisor.request_abort(), FaultCode.ABORTED),
}


@pytest.mark.parametrize("state", LONG_STATES)
@pytest.mark.parametrize("name", list(FAULTS))
def test_a_fault_latches_stops_the_arm_and_nothing_moves_afterwards(tmp_path: Path, state: str, name: str) -> None:
    rig = Rig(tmp_path)
    inject, code = FAULTS[name]
    moves_before: list[int] = []

    def act() -> None:
        moves_before.append(len(rig.arm.moves))
        inject(rig)

    rig.at(state, act)
    outcome = rig.run()
    assert outcome.kind == "fault" and outcome.fault is not None and outcome.fault.code is code
    assert rig.watch.states[-2:] == [state, "FAULT"]
    assert "stop" in rig.arm.moves[moves_before[0] :]
    after_stop = rig.arm.moves[len(rig.arm.moves) - 1 - rig.arm.moves[::-1].index("stop") :]
    assert set(after_stop) == {"stop"}


@pytest.mark.parametrize("name", list(FAULTS))
def test_a_fault_while_charging_leaves_the_plug_where_it_is(tmp_path: Path, name: str) -> None:
    rig = Rig(tmp_path)
    rig.at("CHARGING", lambda: FAULTS[name][0](rig))
    rig.run()
    assert rig.arm.depth_m == pytest.approx(MATED_DEPTH_M, abs=1e-5)
    assert ChargerRequest.UNLOCK_PLUG not in rig.charger.requests


def test_after_a_trip_the_watchdog_is_not_kicked_and_the_heartbeat_says_fault(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.supervisor.start()
    kicks: list[int] = []

    def cut() -> None:
        rig.supervisor.request_abort()
        deadline = rig.supervisor._wall.now_s() + 5.0
        while rig.supervisor.trip is None and rig.supervisor._wall.now_s() < deadline:
            pass
        kicks.append(rig.arm.kicks)

    rig.at("LOCATING", cut)
    try:
        rig.mission.run()
        beats = len(rig.charger.beats)
        deadline = rig.supervisor._wall.now_s() + 5.0
        while len(rig.charger.beats) < beats + 3 and rig.supervisor._wall.now_s() < deadline:
            pass
    finally:
        rig.supervisor.close()
    assert rig.arm.kicks <= kicks[0] + 1
    assert {beat.mode for beat in rig.charger.beats[-2:]} == {15}


def test_a_lost_scanner_ends_the_sweep_but_matters_no_more_once_the_port_is_located(tmp_path: Path) -> None:
    early, late = Rig(tmp_path), Rig(tmp_path)
    early.at("SCANNING", lambda: setattr(early.scanner, "lost", True))
    late.at("APPROACHING", lambda: setattr(late.scanner, "lost", True))
    outcome = early.run()
    assert outcome.fault is not None and outcome.fault.code is FaultCode.SCANNER_LINK_LOST
    assert late.run().kind == "charged"


# --- stop and hold ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "rest"),
    [
        ("SCANNING", ["READY"]),
        ("LOCATING", ["READY"]),
        ("INSERTING", ["RETREATING", "READY"]),
        ("CHARGING", ["RELEASING", "RETREATING", "READY"]),
    ],
)
def test_a_stop_finishes_safely_and_says_stopped(tmp_path: Path, state: str, rest: list[str]) -> None:
    rig = Rig(tmp_path)
    rig.at(state, rig.supervisor.request_stop)
    outcome = rig.run()
    assert outcome.kind == "stopped"
    assert rig.watch.states[rig.watch.states.index(state) + 1 :] == rest
    assert rig.arm.depth_m < 0.0


@pytest.mark.parametrize("state", ["SCANNING", "LOCATING"])
def test_a_person_in_the_zone_before_contact_only_pauses(tmp_path: Path, state: str) -> None:
    rig = Rig(tmp_path)
    entered: list[str] = []

    def on_state(name: str) -> None:
        entered.append(name)
        if name == state and entered.count(state) == 1:
            rig.arm.safety = SafetyMode.SAFEGUARD_STOP
        if name == "HOLD":
            rig.arm.safety = SafetyMode.NORMAL

    rig.watch.on_state = on_state
    assert rig.run().kind == "charged"
    where = rig.watch.states.index("HOLD")
    assert rig.watch.states[where - 1] == state and rig.watch.states[where + 1] == "STAGING"
    assert rig.arm.recoveries == 1


@pytest.mark.parametrize("error", [MotionRefused("the robot stands still"), LinkLostError("no answer")])
def test_a_motion_that_fails_since_a_person_just_stepped_in_is_a_pause_and_no_fault(
    tmp_path: Path, error: PortdockError
) -> None:
    """The robot stops at once; the driver tells of it before a tick has seen why."""
    rig = Rig(tmp_path)
    moved, steps_in = rig.arm.move_joints, [True]

    def refused(*arguments: object) -> int:
        if steps_in:
            steps_in.clear()
            rig.arm.safety = SafetyMode.SAFEGUARD_STOP
            raise error
        return moved(*arguments)  # type: ignore[arg-type]

    def leaves(state: str) -> None:
        if state == "HOLD":
            rig.arm.safety = SafetyMode.NORMAL

    rig.arm.move_joints = refused  # type: ignore[method-assign, assignment]
    rig.watch.on_state = leaves
    assert rig.run().kind == "charged"
    assert rig.watch.states[2:5] == ["STAGING", "HOLD", "STAGING"]
