"""The devices that the supervisor's tick looks at, and one look at all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from controller.heartbeat import Facts
from controller.interlocks import Snapshot
from drivers.base import Arm, Charger, DriverError, Scanner

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class Sources:
    """Three devices; none of them is made to wait for."""

    arm: Arm
    charger: Charger
    scanner: Scanner

    def seen(self, facts: Facts, now_s: float) -> Snapshot:
        """Freshest states and what speaks against each; ``now_s`` is mission time, for the state's deadline."""
        arm, arm_problem = _asked(self.arm.state)
        charger, charger_problem = _asked(self.charger.status)
        scanner = self.scanner.health()
        late = facts.deadline_s is not None and now_s > facts.deadline_s
        overdue = f"{facts.state.name} took longer than allowed" if late else ""
        return Snapshot(facts.state, arm, arm_problem, charger, charger_problem, scanner.up, scanner.detail, overdue)


def _asked(ask: Callable[[], Value]) -> tuple[Value | None, str]:
    try:
        return ask(), ""
    except DriverError as error:
        return None, error.cause
