"""Stops, aborts, losses and defects at moments at which one would rather not have them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Timer
from types import SimpleNamespace
from typing import Any

import pytest

from controller.commands import Laser
from controller.daemon.desk import JobDesk
from controller.daemon.protocol import Request, ResultEvent
from controller.faults import FaultCode, MissionFault, Outcome
from controller.states import State
from controller.sweeping import _laser
from controller.task import Goal, Progress
from drivers.base import ChargerRequest, ChargerState, LinkLostError, LinkOpenError, MotionProgress, SafetyMode
from perception.geometry import Pose
from tests.unit.mission_rig import CLOCK, Rig
from tests.unit.test_undocking import Patient, code, docked_by_an_earlier_process, kinds, run_with


def with_the_desk(rig: Rig, *then: Callable[[], object]) -> tuple[JobDesk, list[str]]:
    """The daemon's own desk; the next of ``then`` follows each result, after the last one the process leaves."""
    results: list[str] = []
    rest = list(then)

    def published(event: object) -> None:
        assert isinstance(event, ResultEvent)
        results.append(event.outcome)
        if rest:
            rest.pop(0)()
        else:
            desk.leave()

    desk = JobDesk(published)
    desk.open(rig.supervisor, lambda: rig.mission.state)
    return desk, results


def test_an_abort_while_an_undock_opens_the_links_is_not_forgotten(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.arm.recover = rig.supervisor.request_abort  # type: ignore[method-assign]
    outcomes = rig.serve(Goal.UNDOCK)
    assert code(outcomes[-1]) is FaultCode.ABORTED
    assert "comply" not in rig.arm.moves


def test_leaving_stops_a_job_that_was_taken_and_has_not_left_ready() -> None:
    asked: list[str] = []
    interrupts: Any = SimpleNamespace(request_stop=lambda: asked.append("stop"), clear_stop=lambda: None)
    desk = JobDesk(lambda event: None)
    desk.open(interrupts, lambda: State.READY)
    desk.submit(Request.DOCK)
    desk.take()
    desk.leave()
    assert asked == ["stop"]


def test_a_stop_for_a_job_that_waits_outlives_the_undock_before_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    desk, results = with_the_desk(
        rig, lambda: setattr(rig.charger, "full", True), lambda: setattr(rig.charger, "full", False)
    )
    rig.at("RELEASING", lambda: (desk.submit(Request.DOCK), desk.submit(Request.STOP)))  # type: ignore[arg-type,return-value]
    desk.submit(Request.DOCK)
    run_with(rig, desk)
    assert results == ["charging", "undocked", "stopped"]


def test_a_stop_that_comes_as_a_job_ends_stops_no_later_one(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    noted = rig.watch.ended
    desk, results = with_the_desk(rig, lambda: desk.submit(Request.UNDOCK), lambda: desk.submit(Request.DOCK))

    def ended(outcome: Outcome, job: Progress) -> None:
        noted(outcome, job)
        if outcome.kind == "undocked":
            desk.submit(Request.STOP)

    rig.watch.ended = ended  # type: ignore[method-assign]
    desk.submit(Request.DOCK)
    run_with(rig, desk)
    assert results == ["charging", "undocked", "charging"]


def test_evidence_that_fails_costs_no_charge_and_no_answer(tmp_path: Path) -> None:
    rig = Rig(tmp_path)

    def ended(outcome: Outcome, job: Progress) -> None:
        raise OSError("no memory")

    rig.watch.ended = ended  # type: ignore[method-assign]
    assert kinds(rig.serve(Goal.DOCK, Goal.UNDOCK)) == ["charging", "undocked"]
    assert ChargerRequest.ABORT not in rig.charger.requests


def test_a_plug_is_taken_out_although_the_scanner_is_gone(tmp_path: Path) -> None:
    rig = Rig(tmp_path)

    def refuse() -> None:
        raise LinkOpenError("no serial device")

    rig.scanner.open = refuse  # type: ignore[method-assign]
    rig.at("CHARGING", lambda: (setattr(rig.scanner, "lost", True), rig.supervisor.request_abort())[0])
    outcomes = rig.serve(Goal.DOCK, Goal.RESET, Goal.UNDOCK)
    assert outcomes[-1].kind == "undocked" and rig.arm.depth_m < 0.0


def test_a_stop_of_a_charge_found_at_the_start_is_an_undock_with_a_result(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.charger._power = True

    class Nobody:
        pending = None
        leaving = property(lambda self: rig.mission.state is State.READY)

        def answered(self, outcome: Outcome) -> None: ...

    nobody: Any = Nobody()
    rig.at("CHARGING", rig.supervisor.request_stop)
    run_with(rig, nobody)
    assert kinds(rig.watch.outcomes) == ["stopped"]
    assert rig.charger.requests[-1] is ChargerRequest.RELEASE


def test_somebody_who_comes_back_while_the_arm_recovers_only_prolongs_the_pause(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    tries: list[int] = []

    def recover() -> None:
        tries.append(1)
        if len(tries) == 1:
            rig.arm.safety = SafetyMode.SAFEGUARD_STOP
            Timer(0.6, lambda: setattr(rig.arm, "safety", SafetyMode.NORMAL)).start()
            raise LinkOpenError("safeguard stop")

    rig.arm.recover = recover  # type: ignore[method-assign]
    seen: list[str] = []

    def on_state(name: str) -> None:
        seen.append(name)
        if name == "SCANNING" and seen.count(name) == 1:
            rig.arm.safety = SafetyMode.SAFEGUARD_STOP
        if name == "HOLD":
            rig.arm.safety = SafetyMode.NORMAL

    rig.watch.on_state = on_state
    assert rig.run().kind == "charged"
    assert len(tries) == 2


def test_an_abort_of_an_undock_that_waits_in_fault_is_not_forgotten(tmp_path: Path) -> None:
    """The job is accepted; the abort comes before the mission has taken it up."""
    rig = docked_by_an_earlier_process(tmp_path)
    desk, results = with_the_desk(rig, lambda: (desk.submit(Request.UNDOCK), desk.submit(Request.ABORT)))
    run_with(rig, desk)
    assert results[-1] == "fault" and rig.mission.fault is not None
    assert "comply" not in rig.arm.moves


def test_a_dock_asked_for_after_a_stop_of_the_charge_does_not_undo_the_stop(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    desk, results = with_the_desk(rig, lambda: (desk.submit(Request.STOP), desk.submit(Request.DOCK)), lambda: None)
    desk.submit(Request.DOCK)
    run_with(rig, desk)
    assert results == ["charging", "stopped", "charging"], "first out, then in again"


def test_a_stop_of_a_charge_whose_axis_nobody_knows_lets_it_go_on(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    rig.charger._power = True
    (tmp_path / "insertion.json").unlink()
    answers: list[Outcome] = []

    class Nobody:
        pending = None
        leaving = property(lambda self: bool(answers))

        def answered(self, outcome: Outcome) -> None:
            answers.append(outcome)

    nobody: Any = Nobody()
    rig.at("CHARGING", rig.supervisor.request_stop)
    run_with(rig, nobody)
    assert code(answers[0]) is FaultCode.AXIS_UNKNOWN
    assert "RELEASING" not in rig.watch.states and ChargerRequest.UNLOCK_PLUG not in rig.charger.requests


def test_a_scanner_that_does_not_go_off_keeps_no_plug_in_the_port(tmp_path: Path) -> None:
    rig = Rig(tmp_path)

    def stop() -> None:
        raise LinkLostError("laser-off is not acknowledged")

    rig.scanner.stop = stop  # type: ignore[method-assign]
    rig.at("CHARGING", rig.supervisor.request_stop)
    assert kinds(rig.serve(Goal.DOCK)) == ["stopped"]
    assert rig.arm.depth_m < 0.0


def test_an_arm_that_was_stopped_in_hold_before_the_port_is_taken_away_by_an_undock(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    move = rig.arm.move_linear

    def linear(target: Pose, speed: float, acceleration: float) -> int:
        number = move(target, speed, acceleration)
        if rig.arm.moves.count("move_linear") == 2:
            rig.arm.speed_scaling = 0.0  # the slider, on the last way
        return number

    rig.arm.move_linear = linear  # type: ignore[method-assign]
    rig.arm.motion = lambda: MotionProgress(1, rig.arm.speed_scaling == 0.0, False, "")  # type: ignore[method-assign]
    rig.at("HOLD", lambda: (setattr(rig.arm, "speed_scaling", 1.0), rig.supervisor.request_stop())[0])
    assert kinds(rig.serve(Goal.DOCK, Goal.UNDOCK, Goal.UNDOCK)) == ["stopped", "undocked", "already-undocked"]
    assert rig.arm.depth_m == pytest.approx(-rig.config.motion.retreat_mm / 1000.0, abs=1e-3)
    assert rig.charger.poses[-1] is None


def test_docked_at_rest_no_deadline_passes(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    deadlines = rig.config.deadlines.model_copy(update={"charging_s": 15.0})  # 0.75 s of wall time
    rig.mission.task.config = rig.config.model_copy(update={"deadlines": deadlines})

    class Weekend(Patient):
        end_s = float("inf")
        leaving = property(lambda self: CLOCK.now_s() > self.end_s)  # type: ignore[assignment]

        def answered(self, outcome: Outcome) -> None:
            self.end_s = CLOCK.now_s() + 1.5

    run_with(rig, Weekend(rig, Goal.DOCK, lambda: None))
    assert kinds(rig.watch.outcomes) == ["charging"]


def test_a_charger_on_its_way_to_finished_has_not_broken_off(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    ask = rig.charger.request

    def over() -> None:
        rig.charger.full = True
        rig.charger.forced.clear()

    def request(what: ChargerRequest, argument: int = 0) -> int:
        number = ask(what, argument)
        if what is ChargerRequest.ENABLE_POWER:
            stopping = {"state": ChargerState.STOPPING, "current_a": 0.0}
            Timer(0.1, lambda: rig.charger.forced.update(stopping)).start()
            Timer(0.3, over).start()
        return number

    rig.charger.request = request  # type: ignore[method-assign]
    assert rig.run().fault is None


def test_what_ended_a_sweep_is_its_cause_and_not_the_laser_that_does_not_go_off() -> None:
    asked: list[bool] = []

    def do(command: Laser) -> None:
        asked.append(command.on)
        if not command.on:
            raise LinkLostError("laser-off is not acknowledged")

    cell: Any = SimpleNamespace(do=do, supervisor=SimpleNamespace(wait=lambda until, patience_s: False), time_scale=1.0)
    collector: Any = SimpleNamespace(collect=lambda: False)
    with pytest.raises(MissionFault, match="no profile comes"), _laser(cell, collector):
        pass
    assert asked == [True, False]
