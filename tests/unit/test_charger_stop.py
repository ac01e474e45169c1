"""The charger's emergency stop stays latched there when it is released: only an operator's reset ends it."""

from __future__ import annotations

from pathlib import Path

import pytest

from controller.faults import FaultCode
from controller.task import Goal
from drivers.base import ChargerRequest, ChargerState, RequestResult
from tests.unit.mission_rig import Rig
from tests.unit.test_undocking import code, docked_by_an_earlier_process, kinds


class PressedAtTheCharger:
    """A charger whose emergency stop is pressed and released, and that stays in ESTOP until it is reset."""

    def __init__(self, rig: Rig) -> None:
        self.rig, ask = rig, rig.charger.request

        def request(request: ChargerRequest, argument: int = 0) -> int:
            number = ask(request, argument)
            if request is ChargerRequest.RESET_FAULT and not rig.charger.forced.get("estop"):
                rig.charger.forced = {}
            return number

        rig.charger.request = request  # type: ignore[method-assign]

    def press(self) -> None:
        self.rig.charger.forced = {"state": ChargerState.ESTOP, "estop": True, "motion_inhibit": True}

    def release(self) -> None:
        self.rig.charger.forced = {"state": ChargerState.ESTOP, "motion_inhibit": True}


@pytest.mark.parametrize("state", ["SCANNING", "APPROACHING", "INSERTING"])
def test_after_an_emergency_stop_at_the_charger_a_reset_makes_the_cell_ready(tmp_path: Path, state: str) -> None:
    rig = Rig(tmp_path)
    stop = PressedAtTheCharger(rig)
    rig.at(state, stop.press)
    outcomes = rig.serve(Goal.CYCLE, Goal.RESET, stop.release, Goal.DOCK, Goal.RESET, Goal.DOCK)
    pressed = FaultCode.EMERGENCY_STOP
    assert [code(o) for o in outcomes] == [pressed, pressed, pressed, None, None], "a job is no reset"
    assert kinds(outcomes[3:]) == ["ready", "charging"]


def test_after_an_emergency_stop_at_the_charger_a_docked_plug_is_taken_out(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    stop = PressedAtTheCharger(rig)
    rig.at("CHARGING", stop.press)
    outcomes = rig.serve(Goal.DOCK, stop.release, Goal.RESET, Goal.UNDOCK)
    assert [code(o) for o in outcomes] == [FaultCode.EMERGENCY_STOP, FaultCode.PLUG_INSERTED_AT_START, None]
    assert outcomes[-1].kind == "undocked" and rig.arm.depth_m < 0.0


def test_a_daemon_that_starts_after_one_with_the_plug_in_takes_no_undock_for_a_reset(tmp_path: Path) -> None:
    rig = docked_by_an_earlier_process(tmp_path)
    PressedAtTheCharger(rig).release()
    moves = len(rig.arm.moves)
    outcomes = rig.serve(Goal.UNDOCK, Goal.DOCK, Goal.RESET, Goal.UNDOCK)
    stopped = FaultCode.EMERGENCY_STOP
    at_start_and_after = [stopped] * 3
    assert [code(o) for o in outcomes] == [*at_start_and_after, FaultCode.PLUG_INSERTED_AT_START, None]
    assert outcomes[-1].kind == "undocked"
    resets = [k for k, r in enumerate(rig.charger.requests) if r is ChargerRequest.RESET_FAULT]
    assert len(resets) == 1 and "comply" not in rig.arm.moves[:moves]


def test_a_charger_that_refuses_the_reset_is_quoted(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.charger.forced = {"state": ChargerState.ESTOP, "motion_inhibit": True}
    rig.charger.result = lambda number: RequestResult.REJECTED  # type: ignore[method-assign]
    rig.charger.refusal = lambda: "PowerNotOff"  # type: ignore[method-assign]
    outcomes = rig.serve(Goal.RESET)
    assert "PowerNotOff" not in str(outcomes[0].fault), "at the start nothing is asked for"
    assert "PowerNotOff" in str(outcomes[1].fault)


def test_a_daemon_that_starts_after_one_does_not_reset_the_charger_by_itself(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    PressedAtTheCharger(rig).release()
    outcomes = rig.serve(Goal.DOCK)
    assert code(outcomes[0]) is FaultCode.EMERGENCY_STOP
    assert ChargerRequest.RESET_FAULT not in rig.charger.requests
