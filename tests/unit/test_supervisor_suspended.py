"""A process that did not run for a while, as on a suspended computer: its own sleep is named, not the silent links."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from controller.config import load_config
from controller.faults import FaultCode, MissionFault
from controller.sources import Sources
from controller.states import State
from controller.supervisor import Supervisor
from drivers.base import ArmState, LinkLostError
from tests.unit.mission_rig import CLOCK, StandInArm, StandInCharger, StandInScanner

AWAY_S = 4.0


class Wall:
    """The host's clock, which goes on while the process sleeps."""

    def __init__(self) -> None:
        self.slept_s = 0.0

    def now_s(self) -> float:
        return CLOCK.now_s() + self.slept_s


class Arm(StandInArm):
    """Stale once the process has slept."""

    def __init__(self, wall: Wall) -> None:
        super().__init__(load_config().port.T_base_port.pose)
        self._wall = wall
        self.in_state: Callable[[], None] = lambda: None
        self.in_kick: Callable[[], None] = lambda: None

    def state(self) -> ArmState:
        self.in_state()
        if self._wall.slept_s:
            raise LinkLostError(f"the newest sample is {AWAY_S} s old")
        return super().state()

    def kick_watchdog(self) -> None:
        super().kick_watchdog()
        self.in_kick()


@pytest.fixture
def wall() -> Wall:
    return Wall()


@pytest.fixture
def arm(wall: Wall) -> Arm:
    return Arm(wall)


@pytest.fixture
def supervisor(arm: Arm, wall: Wall) -> Iterator[Supervisor]:
    one = Supervisor(Sources(arm, StandInCharger(arm), StandInScanner()), wall, wall)
    yield one
    one.close()


def trip(supervisor: Supervisor) -> FaultCode:
    supervisor.enter(State.CHARGING, None)
    supervisor.start()
    with pytest.raises(MissionFault) as tripped:
        supervisor.wait(lambda: False, 20.0)
    supervisor.close()
    return tripped.value.fault.code


@pytest.mark.parametrize("where", ["in_state", "in_kick"])
def test_a_sleep_inside_a_tick_is_a_stall_and_not_a_lost_arm(
    supervisor: Supervisor, arm: Arm, wall: Wall, where: str
) -> None:
    def sleep() -> None:
        if arm.kicks > 20:
            wall.slept_s = AWAY_S

    setattr(arm, where, sleep)
    assert trip(supervisor) is FaultCode.SUPERVISOR_STALLED
    assert arm.moves[-1] == "stop"


def test_an_arm_that_is_stale_while_the_process_runs_is_a_lost_arm(supervisor: Supervisor, arm: Arm) -> None:
    arm.in_kick = lambda: setattr(arm, "lost", arm.kicks > 20)
    assert trip(supervisor) is FaultCode.ARM_LINK_LOST
