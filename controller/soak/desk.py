"""The soak's desk: the next mission, and after a fault what an operator would do until the cell is ready again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from controller.faults import FaultCode, Outcome
from controller.task import Goal

MOST_RESETS = 12
"""An operator who has reset so often would call somebody."""


@dataclass(slots=True)
class SoakDesk:
    """``controller.task.Desk``: cycles, and resets and undocks in between."""

    missions: int
    ended: Callable[[Outcome], None]
    """Told the outcome of each mission."""
    repair: Callable[[], None]
    """Removes what troubled the mission: what an operator does before a reset."""
    enough: Callable[[], bool]
    begins: Callable[[], None] = lambda: None
    """Told that a mission is about to begin."""
    pending: Goal | None = Goal.CYCLE
    leaving: bool = False
    given_up: str = ""
    """Why the cell could not be made ready again."""
    _doing: Goal | None = None
    _resets: int = 0

    def take(self) -> Goal:
        """The next job."""
        goal, self.pending = self.pending, None
        assert goal is not None
        self._doing = goal
        if goal is Goal.CYCLE:
            self.begins()
        return goal

    def answered(self, outcome: Outcome) -> None:
        """What follows a job's end."""
        doing, self._doing = self._doing, None
        if doing is Goal.CYCLE:
            self.missions -= 1
            self.ended(outcome)
            self._resets = 0
        self.repair()
        if outcome.fault is None or outcome.kind == "refused":
            self._next(Goal.UNDOCK if outcome.kind == "charging" else Goal.CYCLE)
            return
        if outcome.kind == "intervention-needed" and doing is Goal.CYCLE and outcome.fault.code in _BACK_IN_READY:
            self._next(Goal.CYCLE)
            return
        self._resets += 1
        if self._resets > MOST_RESETS:
            self.given_up, self.leaving = str(outcome.fault), True
            return
        self.pending = Goal.UNDOCK if outcome.fault.code is FaultCode.PLUG_INSERTED_AT_START else Goal.RESET

    def _next(self, goal: Goal) -> None:
        if goal is Goal.CYCLE and (self.missions <= 0 or self.enough()):
            self.leaving = True
        else:
            self.pending = goal


_BACK_IN_READY = (FaultCode.INSERTION_BLOCKED, FaultCode.FORCE_LIMIT, FaultCode.NOT_MATED, FaultCode.NOT_CHARGING)
"""After these the arm has retreated and waits in READY."""
