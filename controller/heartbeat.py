"""What the charger is told 20 times a second, and when: the robot's mode, state, flags and mission."""

from __future__ import annotations

from dataclasses import dataclass

from controller.interlocks import Snapshot
from controller.states import State
from drivers.base import Clock, Heartbeat, SafetyMode

HEARTBEAT_S = 0.05
FAULT_MODE = 15
"""Tells the charger that the robot is in FAULT (docs/can.md)."""


@dataclass(slots=True)
class Facts:
    """What the mission knows and the heartbeat tells; set by the mission, read by the tick."""

    state: State = State.OFFLINE
    deadline_s: float | None = None
    mode: int = 1
    cycle_id: int = 0
    tool_holds_plug: bool = True
    clear_of_vehicle: bool = True
    mated: bool = False


def beat(facts: Facts, seen: Snapshot, tripped: bool) -> Heartbeat:
    """The heartbeat for what is known and was seen; flags in the order of docs/can.md."""
    arm = seen.arm
    normal = arm is not None and arm.safety in (SafetyMode.NORMAL, SafetyMode.REDUCED)
    protective = arm is not None and arm.safety is SafetyMode.PROTECTIVE_STOP
    bits = (
        normal,
        protective,
        facts.tool_holds_plug,
        facts.state in (State.READY, State.SELF_CHECK),
        facts.clear_of_vehicle,
        facts.mated,
        seen.scanner_up,
        arm is not None,
        arm is not None and arm.moving,
    )
    mode = FAULT_MODE if tripped or facts.state is State.FAULT else facts.mode
    flags = sum(1 << k for k, bit in enumerate(bits) if bit)
    return Heartbeat(mode, int(facts.state), flags, facts.cycle_id)


class Rhythm:
    """A period kept by the clock: callers that come late or early do not shift it."""

    def __init__(self, clock: Clock, period_s: float, early_s: float) -> None:
        """``early_s``: a caller who comes so much too early is in time."""
        self._clock, self._period_s, self._early_s = clock, period_s, early_s
        self._due_s = clock.now_s()

    def is_due(self) -> bool:
        """Whether it is time again; then the next time is set. After a gap longer than a period it begins anew."""
        now_s = self._clock.now_s()
        if now_s < self._due_s - self._early_s:
            return False
        self._due_s += self._period_s
        if self._due_s <= now_s:
            self._due_s = now_s + self._period_s
        return True
