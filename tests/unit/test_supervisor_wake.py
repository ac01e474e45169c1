"""A tick that is called for early, by the charger's news, comes in addition: the next one keeps its time."""

from __future__ import annotations

import time

from controller.config import load_config
from controller.sources import Sources
from controller.states import State
from controller.supervisor import TICK_S, Supervisor
from tests.unit.mission_rig import CLOCK, StandInArm, StandInCharger, StandInScanner

WAKES = 200
TURN_S = 0.5 * WAKES * TICK_S


def test_many_early_ticks_do_not_put_the_next_one_off() -> None:
    arm = StandInArm(load_config().port.T_base_port.pose)
    supervisor = Supervisor(Sources(arm, StandInCharger(arm), StandInScanner()), CLOCK, CLOCK)
    supervisor.enter(State.READY, None)
    supervisor.start()
    try:
        for _ in range(WAKES):
            before = supervisor.ticks
            supervisor.wake()
            until_ticked(supervisor, before, 5.0)
        until_ticked(supervisor, supervisor.ticks, TURN_S)
    finally:
        supervisor.close()


def until_ticked(supervisor: Supervisor, before: int, timeout_s: float) -> None:
    end_s = time.monotonic() + timeout_s
    while supervisor.ticks == before:
        assert time.monotonic() < end_s, "the supervisor does not tick"
        time.sleep(0.0002)
