"""An emergency stop ends the arm's script: a command that fails of it must not hide it. Found by the campaign."""

from __future__ import annotations

import threading
from pathlib import Path

from controller.faults import FaultCode
from drivers.base import LinkLostError, RequestResult
from tests.unit.mission_rig import PACE, Rig


def test_a_link_that_an_emergency_stop_takes_down_is_not_named_as_the_cause(tmp_path: Path) -> None:
    rig = Rig(tmp_path)

    def dies_of_the_stop() -> None:
        rig.charger.forced.update(estop=True)
        raise LinkLostError("the arm's control link is lost")

    rig.arm.zero_force_sensor = dies_of_the_stop  # type: ignore[method-assign]
    outcome = rig.run()
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.EMERGENCY_STOP


def test_a_link_that_is_lost_by_itself_is_named(tmp_path: Path) -> None:
    rig = Rig(tmp_path)

    def dies() -> None:
        raise LinkLostError("the arm's control link is lost")

    rig.arm.zero_force_sensor = dies  # type: ignore[method-assign]
    outcome = rig.run()
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.ARM_LINK_LOST


def test_a_charger_that_falls_silent_is_not_said_to_have_refused(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.cell.time_scale = PACE
    rig.config = rig.config.model_copy(update={"charger": rig.config.charger.model_copy(update={"lost_ms": 3000.0})})
    rig.mission.task.config = rig.config

    def no_answer(sequence: int) -> RequestResult:
        threading.Timer(0.1, lambda: setattr(rig.charger, "lost", True)).start()
        return RequestResult.TIMED_OUT

    rig.charger.result = no_answer  # type: ignore[method-assign]
    outcome = rig.run()
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.CHARGER_LINK_LOST
