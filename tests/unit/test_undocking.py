"""The mission as the daemon runs it: docking and undocking as jobs, what is done already, faults, resets, restarts."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from controller.durable import recall_insertion
from controller.faults import FaultCode, Outcome
from controller.planning import FACING
from controller.states import State
from controller.task import Desk, Goal
from drivers.base import (
    ChargerRequest,
    Heartbeat,
    LinkOpenError,
    PlugLock,
    Proximity,
    SafetyMode,
)
from perception.geometry import Pose
from tests.unit.mission_rig import CLOCK, MATED_DEPTH_M, Rig, Script

DOCKED = ["SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING", "CHARGING"]
UNDOCKED = ["RELEASING", "RETREATING", "READY"]


def kinds(outcomes: list[Outcome]) -> list[str]:
    return [outcome.kind for outcome in outcomes]


def code(outcome: Outcome) -> FaultCode | None:
    return None if outcome.fault is None else outcome.fault.code


def docked_by_an_earlier_process(folder: Path) -> Rig:
    """A plug in the port, locked, the axis on disk: what a killed daemon leaves behind."""
    before = Rig(folder)
    stored: list[str] = []
    before.at("CHARGING", lambda: stored.append((folder / "insertion.json").read_text()))
    before.run()
    (folder / "insertion.json").write_text(stored[0])
    rig = Rig(folder)
    rig.arm.pose = rig.arm.T_base_port @ Pose(FACING, np.array([0.0, 0.0, -MATED_DEPTH_M]))
    rig.charger._lock = PlugLock.LOCKED
    return rig


# --- jobs -------------------------------------------------------------------------------------------------------------


def test_a_dock_job_ends_with_a_measured_current_and_an_undock_job_clear_of_the_vehicle(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    assert kinds(rig.serve(Goal.DOCK, Goal.UNDOCK)) == ["charging", "undocked"]
    assert rig.watch.states == [*DOCKED, *UNDOCKED, "OFFLINE"]
    assert rig.watch.goals == [Goal.DOCK, Goal.UNDOCK] and kinds(rig.watch.outcomes) == ["charging", "undocked"]
    assert rig.arm.depth_m == pytest.approx(-0.09) and rig.decisions.refused == []


def test_what_is_done_already_is_answered_at_once_and_nothing_moves(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    moves: list[int] = []
    outcomes = rig.serve(
        Goal.UNDOCK,
        Goal.DOCK,
        lambda: moves.append(len(rig.arm.moves)),
        Goal.DOCK,
        lambda: moves.append(len(rig.arm.moves)),
        Goal.UNDOCK,
        Goal.UNDOCK,
    )
    assert kinds(outcomes) == ["already-undocked", "charging", "already-docked", "undocked", "already-undocked"]
    assert moves[0] == moves[1]
    assert rig.watch.goals == [Goal.DOCK, Goal.UNDOCK], "answers at once are no missions"


def test_a_second_dock_job_looks_afresh(tmp_path: Path) -> None:
    rig = Rig(tmp_path, accepted=[False, True])
    assert kinds(rig.serve(Goal.DOCK, Goal.UNDOCK, Goal.DOCK, Goal.UNDOCK)) == ["charging", "undocked"] * 2
    assert rig.watch.states.count("SCANNING") == 4


def test_a_full_vehicle_is_undocked_unasked(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    run_with(rig, Patient(rig, Goal.DOCK, lambda: setattr(rig.charger, "full", True)))
    assert kinds(rig.watch.outcomes) == ["charging", "undocked"]
    assert rig.watch.states[-4:] == [*UNDOCKED, "OFFLINE"]


def test_a_charge_that_breaks_off_is_begun_again_once_then_a_person_is_asked_for(tmp_path: Path) -> None:
    rig = Rig(tmp_path)

    def lose() -> None:
        rig.charger._power = False
        rig.charger.gives_current = False

    run_with(rig, Patient(rig, Goal.DOCK, lose))
    assert kinds(rig.watch.outcomes) == ["charging", "intervention-needed"]
    assert code(rig.watch.outcomes[1]) is FaultCode.NOT_CHARGING
    assert rig.charger.requests.count(ChargerRequest.ENABLE_POWER) == 2
    assert rig.arm.depth_m < 0.0


class Patient:
    """A desk with one job; then something happens to the docked plug, and the process leaves once back in READY."""

    def __init__(self, rig: Rig, goal: Goal, then: Callable[[], None]) -> None:
        self._rig, self._then = rig, then
        self.pending: Goal | None = goal

    @property
    def leaving(self) -> bool:
        return self._rig.mission.state in (State.READY, State.FAULT) and len(self._rig.watch.states) > len(DOCKED)

    def take(self) -> Goal:
        goal, self.pending = self.pending, None
        assert goal is not None
        return goal

    def answered(self, outcome: Outcome) -> None:
        if outcome.kind == "charging":
            self._then()


def run_with(rig: Rig, desk: Desk) -> None:
    rig.supervisor.start()
    try:
        rig.mission.serve(desk)
    finally:
        rig.supervisor.close()


# --- pulling out ------------------------------------------------------------------------------------------------------


def test_power_is_seen_off_before_the_lock_opens_and_the_lock_open_before_the_pull(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    order: list[str] = []
    request, comply = rig.charger.request, rig.arm.comply

    def asked(what: ChargerRequest, argument: int = 0) -> int:
        order.append(what.name)
        return request(what, argument)

    def pulled(compliance) -> None:  # type: ignore[no-untyped-def]
        order.append("pull" if compliance.wrench[2] < 0 else "push")
        comply(compliance)

    rig.charger.request, rig.arm.comply = asked, pulled  # type: ignore[method-assign]
    rig.serve(Goal.DOCK, Goal.UNDOCK)
    assert order[order.index("ENABLE_POWER") :] == ["ENABLE_POWER", "STOP_POWER", "UNLOCK_PLUG", "pull", "RELEASE"]


@pytest.mark.parametrize(
    "still_live",
    [{"contactor_closed": True}, {"current_a": 1.0}, {"electrical_time_s": 0.0}],
    ids=["contactor closed", "current", "measured before the request"],
)
def test_a_plug_that_is_not_seen_dead_is_neither_unlocked_nor_moved(
    tmp_path: Path, still_live: dict[str, object]
) -> None:
    rig = Rig(tmp_path)
    outcomes = rig.serve(Goal.DOCK, lambda: rig.charger.forced.update(still_live), Goal.UNDOCK)
    assert kinds(outcomes) == ["charging", "intervention-needed"]
    assert code(outcomes[1]) is FaultCode.RELEASE_FAILED and outcomes[1].fault and outcomes[1].fault.remedy
    assert ChargerRequest.UNLOCK_PLUG not in rig.charger.requests
    assert rig.arm.depth_m == pytest.approx(MATED_DEPTH_M, abs=1e-5)


def test_a_lock_that_stays_closed_is_never_pulled_against(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    outcomes = rig.serve(Goal.DOCK, lambda: rig.charger.forced.update(lock=PlugLock.LOCKED), Goal.UNDOCK)
    assert code(outcomes[1]) is FaultCode.RELEASE_FAILED
    assert rig.arm.depth_m == pytest.approx(MATED_DEPTH_M, abs=1e-5)


def test_a_plug_that_does_not_come_is_left_and_a_person_asked_for(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    outcomes = rig.serve(Goal.DOCK, lambda: setattr(rig.arm, "stuck", True), Goal.UNDOCK)
    assert (outcomes[1].kind, code(outcomes[1])) == ("intervention-needed", FaultCode.WITHDRAWAL_BLOCKED)
    assert rig.watch.states[-3:] == ["RETREATING", "FAULT", "OFFLINE"]
    assert rig.arm.moves[-1] == "stop" and recall_insertion(tmp_path) is not None


# --- the last rung ----------------------------------------------------------------------------------------------------


def test_on_final_failure_hold_the_arm_stands_where_it_is_until_a_person_resets(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    hold = rig.config.mission.model_copy(update={"on_final_failure": "hold", "max_attempts": 2})
    rig.mission.task.config = rig.config.model_copy(update={"mission": hold})
    rig.arm.stop_depth_m = 0.008
    outcome = rig.run()
    assert (outcome.kind, code(outcome)) == ("intervention-needed", FaultCode.INSERTION_BLOCKED)
    assert rig.watch.states.count("RETREATING") == 1 and rig.watch.states[-2:] == ["INSERTING", "FAULT"]
    assert rig.arm.depth_m == pytest.approx(0.008, abs=1e-5)


# --- faults and resets ------------------------------------------------------------------------------------------------


def test_a_latched_fault_answers_every_job_but_the_reset(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.at("SCANNING", rig.supervisor.request_abort)
    outcomes = rig.serve(Goal.DOCK, Goal.DOCK, Goal.UNDOCK, Goal.RESET, Goal.DOCK)
    assert kinds(outcomes) == ["fault", "fault", "fault", "ready", "charging"]
    assert {code(o) for o in outcomes[:3]} == {FaultCode.ABORTED}
    assert rig.arm.recoveries == 1


class AfterReady(Script):
    """A desk that nobody has come to before the robot is ready."""

    def __init__(self, rig: Rig, *jobs: Goal | Callable[[], None]) -> None:
        super().__init__(*jobs)
        self._rig, self._looked = rig, False

    @property
    def pending(self) -> Goal | None:
        ready, self._looked = self._looked, self._rig.mission.state is State.READY
        return super().pending if ready else None


def test_a_stop_during_the_first_self_check_stops_no_later_job(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.at("SELF_CHECK", rig.supervisor.request_stop)
    desk = AfterReady(rig, Goal.DOCK)
    run_with(rig, desk)
    assert kinds(desk.outcomes) == ["charging"]


def test_a_stop_during_the_self_check_of_a_job_that_waits_stops_that_job(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.at("SELF_CHECK", rig.supervisor.request_stop)
    assert kinds(rig.serve(Goal.DOCK)) == ["stopped"]


def test_a_reset_that_the_arm_does_not_take_leaves_the_fault_latched(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.at("SCANNING", rig.supervisor.request_abort)

    def refuse() -> None:
        raise LinkOpenError("the robot is in local mode")

    rig.arm.recover = refuse  # type: ignore[method-assign]
    outcomes = rig.serve(Goal.DOCK, Goal.RESET, Goal.DOCK)
    assert [code(o) for o in outcomes] == [FaultCode.ABORTED, FaultCode.RESET_REFUSED, FaultCode.ABORTED]
    assert "local mode" in str(outcomes[1].fault)


def test_a_reset_while_the_cause_is_still_there_latches_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.at("SCANNING", lambda: setattr(rig.arm, "safety", SafetyMode.ROBOT_ESTOP))
    outcomes = rig.serve(Goal.DOCK, Goal.RESET)
    assert [code(o) for o in outcomes] == [FaultCode.EMERGENCY_STOP] * 2


def test_a_scanner_that_went_and_came_at_rest_is_opened_again_for_the_next_job(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.scanner.open = lambda: setattr(rig.scanner, "lost", False)  # type: ignore[method-assign]
    outcomes = rig.serve(Goal.DOCK, Goal.UNDOCK, lambda: setattr(rig.scanner, "lost", True), Goal.DOCK)
    assert kinds(outcomes) == ["charging", "undocked", "charging"]


def test_a_scanner_that_stays_away_is_the_fault_of_the_next_job(tmp_path: Path) -> None:
    rig = Rig(tmp_path)

    def gone() -> None:
        raise LinkOpenError("no serial device")

    rig.scanner.open = gone  # type: ignore[method-assign]
    rig.scanner.lost = True
    outcomes = rig.serve(Goal.DOCK)
    assert code(outcomes[0]) is FaultCode.SCANNER_LINK_LOST
    assert rig.arm.moves.count("move_joints") == 0


def test_an_abort_while_docked_is_left_by_reset_then_undock(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.at("CHARGING", rig.supervisor.request_abort)
    outcomes = rig.serve(Goal.DOCK, Goal.UNDOCK, Goal.RESET, Goal.UNDOCK)
    inserted = FaultCode.PLUG_INSERTED_AT_START
    assert [code(o) for o in outcomes] == [FaultCode.ABORTED, FaultCode.ABORTED, inserted, None]
    assert outcomes[-1].kind == "undocked" and rig.arm.depth_m < 0.0


def test_a_stop_while_docked_and_at_rest_takes_the_plug_out(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    run_with(rig, Patient(rig, Goal.DOCK, rig.supervisor.request_stop))
    assert kinds(rig.watch.outcomes) == ["charging", "stopped"]
    assert rig.watch.states[-4:] == [*UNDOCKED, "OFFLINE"] and rig.arm.depth_m < 0.0


EVERY_STATE = [
    "SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING", "CHARGING",
    "RELEASING", "RETREATING", "HOLD",
]  # fmt: skip
INTERRUPTIONS: dict[str, tuple[Callable[[Rig], None], FaultCode]] = {
    "abort": (lambda rig: rig.supervisor.request_abort(), FaultCode.ABORTED),
    "e-stop at the robot": (
        lambda rig: setattr(rig.arm, "safety", SafetyMode.ROBOT_ESTOP),
        FaultCode.EMERGENCY_STOP,
    ),
    "e-stop at the charger": (lambda rig: rig.charger.forced.update(estop=True), FaultCode.EMERGENCY_STOP),
}


@pytest.mark.parametrize("state", EVERY_STATE)
@pytest.mark.parametrize("name", list(INTERRUPTIONS))
def test_an_abort_or_e_stop_in_any_state_latches_and_nothing_is_commanded_after_it(
    tmp_path: Path, state: str, name: str
) -> None:
    rig = Rig(tmp_path)
    interrupt, expected = INTERRUPTIONS[name]
    tripped_after: list[int] = []

    def act() -> None:
        interrupt(rig)
        deadline = CLOCK.now_s() + 10.0
        while rig.supervisor.trip is None and CLOCK.now_s() < deadline:
            time.sleep(0.001)
        tripped_after.append(len(rig.arm.moves))

    entered: list[str] = []

    def on_state(name: str) -> None:
        entered.append(name)
        if state == "HOLD" and name == "SCANNING":
            rig.arm.safety = SafetyMode.SAFEGUARD_STOP
        if name == state and entered.count(state) == 1:
            act()

    rig.watch.on_state = on_state
    outcome = rig.run()
    assert (outcome.kind, code(outcome)) == ("fault", expected)
    assert rig.watch.states[-2:] == [state, "FAULT"]
    assert set(rig.arm.moves[tripped_after[0] :]) <= {"stop"} and rig.arm.moves[-1] == "stop"
    live = {ChargerRequest.ENABLE_POWER, ChargerRequest.UNLOCK_PLUG}
    assert rig.charger.requests[-1] is ChargerRequest.ABORT
    assert not (live & set(rig.charger.requests) and state in ("SELF_CHECK", "STAGING", "SCANNING", "LOCATING"))


# --- a start with a plug in the port ----------------------------------------------------------------------------------


def test_a_charge_found_at_the_start_is_observed_and_nothing_moves(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.charger._power = True
    assert kinds(rig.serve(Goal.DOCK, Goal.RESET)) == ["already-docked", "charging"]
    assert rig.watch.states[:2] == ["SELF_CHECK", "CHARGING"]
    assert rig.arm.moves == [] and ChargerRequest.ENABLE_POWER not in rig.charger.requests


def test_a_charge_found_at_the_start_can_be_ended_by_an_undock(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.charger._power = True
    assert kinds(rig.serve(Goal.UNDOCK)) == ["undocked"]
    assert rig.watch.states == ["SELF_CHECK", "CHARGING", *UNDOCKED, "OFFLINE"]


def test_a_plug_found_without_current_is_said_and_taken_out_only_when_asked_for(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    moves: list[str] = []
    outcomes = rig.serve(Goal.DOCK, lambda: moves.extend(rig.arm.moves), Goal.UNDOCK)
    assert code(rig.watch.outcomes[0]) is FaultCode.PLUG_INSERTED_AT_START
    assert [code(o) for o in outcomes] == [FaultCode.PLUG_INSERTED_AT_START, FaultCode.PLUG_INSERTED_AT_START, None]
    assert set(moves) <= {"stop"} and outcomes[-1].kind == "undocked"
    assert rig.watch.states == ["SELF_CHECK", "FAULT", "SELF_CHECK", *UNDOCKED, "OFFLINE"]


def test_without_a_stored_axis_the_arm_never_pulls(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    (tmp_path / "insertion.json").unlink()
    outcomes = rig.serve(Goal.UNDOCK)
    assert code(outcomes[-1]) is FaultCode.AXIS_UNKNOWN and set(rig.arm.moves) <= {"stop"}


def test_an_arm_beside_the_stored_axis_never_pulls(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.arm.pose = rig.arm.pose.moved([0.008, 0.0, 0.0])
    outcomes = rig.serve(Goal.UNDOCK)
    assert code(outcomes[-1]) is FaultCode.AXIS_UNKNOWN and set(rig.arm.moves) <= {"stop"}


def test_a_plug_half_in_is_known_by_the_stored_axis_although_the_contact_senses_nothing(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.arm.pose = rig.arm.T_base_port @ Pose(FACING, np.array([0.0, 0.0, -0.008]))
    rig.charger._lock = PlugLock.UNLOCKED
    rig.serve(Goal.DOCK)
    assert code(rig.watch.outcomes[0]) is FaultCode.PLUG_INSERTED_AT_START
    assert set(rig.arm.moves) <= {"stop"}


def test_an_arm_that_a_person_has_driven_away_forgets_the_stored_axis(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.charger._lock = PlugLock.UNLOCKED
    rig.arm.pose = rig.arm.T_base_port @ Pose(FACING, np.array([0.1, 0.0, 0.2]))
    assert kinds(rig.serve(Goal.UNDOCK)) == ["already-undocked"]
    assert recall_insertion(tmp_path) is None


def test_an_arm_left_before_the_port_backs_out_on_the_axis_before_it_goes_elsewhere(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.charger._lock = PlugLock.UNLOCKED
    rig.arm.pose = rig.arm.T_base_port @ Pose(FACING, np.array([0.0, 0.0, 0.03]))
    assert kinds(rig.serve(Goal.DOCK)) == ["charging"]
    assert rig.arm.moves[:2] == ["move_linear", "move_joints"]


def test_a_plug_put_in_by_hand_while_ready_is_not_docked_over(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    outcomes = rig.serve(lambda: rig.charger.forced.update(proximity=Proximity.INSERTED), Goal.DOCK)
    assert code(outcomes[-1]) is FaultCode.PLUG_INSERTED_AT_START and set(rig.arm.moves) <= {"stop"}


# --- leaving ----------------------------------------------------------------------------------------------------------


def test_the_process_that_ends_while_docked_switches_off_and_leaves_the_plug_locked(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    moves: list[int] = []
    rig.serve(Goal.DOCK, lambda: moves.append(len([m for m in rig.arm.moves if m != "stop"])))
    assert rig.watch.states[-2:] == ["CHARGING", "OFFLINE"]
    assert rig.charger.requests[-1] is ChargerRequest.STOP_POWER and rig.charger._lock is PlugLock.LOCKED
    assert len([m for m in rig.arm.moves if m != "stop"]) == moves[0]
    assert json.loads((tmp_path / "insertion.json").read_text())


def test_heartbeats_say_mated_while_a_found_charge_is_observed(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.charger._power = True
    beats: list[Heartbeat] = []

    def wait_for_beats() -> None:
        beats[:] = [b for b in rig.charger.beats if b.state == State.CHARGING]

    rig.at("CHARGING", lambda: rig.supervisor.wait_ticks(12))
    rig.serve(Goal.DOCK, wait_for_beats, Goal.DOCK)
    assert beats and all(beat.flags & 1 << 5 and not beat.flags & 1 << 4 for beat in beats)
