"""What the steps of a mission share: the cell, the job at hand and how far it has come, and whom to tell."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from controller.cell import Cell
from controller.config import SiteConfig
from controller.faults import Fault, FaultCode, MissionFault, Outcome
from controller.insertion import Insertion
from controller.looking import Looking
from controller.planning import DockPlan
from drivers.base import ChargerRequest, RequestResult
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud

_UNANSWERED = (RequestResult.PENDING, RequestResult.TIMED_OUT)


class Goal(enum.Enum):
    """What can be asked of a mission."""

    CYCLE = "cycle"
    """Dock, charge for ``mission.charge_s``, undock: dry run and soak."""
    DOCK = "dock"
    """Dock and charge; done when the current has been measured for ``mission.charge_s``."""
    UNDOCK = "undock"
    RESET = "reset"
    """An operator's reset out of FAULT."""


class Watcher(Protocol):
    """Who is told what happens: recorder, terminal, subscribers."""

    def began(self, goal: Goal) -> None: ...
    def transition(self, source: str, event: str, target: str, time_s: float) -> None: ...
    def progress(self, label: str, fraction: float, detail: str) -> None: ...
    def scan(self, cloud: Cloud) -> None: ...
    def estimate(self, estimate: PortEstimate) -> None: ...
    def insertion(self, insertion: Insertion) -> None: ...
    def ended(self, outcome: Outcome, job: Progress) -> None: ...


class Desk(Protocol):
    """Where jobs come from. ``pending`` and ``leaving`` are looked at with each tick."""

    @property
    def pending(self) -> Goal | None: ...
    @property
    def leaving(self) -> bool: ...
    def take(self) -> Goal: ...
    def answered(self, outcome: Outcome) -> None: ...


@dataclass(slots=True)
class SingleJob:
    """A desk with one job, for a mission that is run once."""

    pending: Goal | None
    leaving: bool = False

    def take(self) -> Goal:
        """The job; from then on there is none."""
        goal, self.pending = self.pending, None
        assert goal is not None
        return goal

    def answered(self, outcome: Outcome) -> None:
        """Nobody else waits for it."""


@dataclass(slots=True)
class Progress:
    """What a job has come to so far."""

    goal: Goal | None = None
    """None: no job is under way."""
    under_way: bool = False
    """The procedure has left its state of rest for this job."""
    reserved: bool = False
    """The charger has been reserved and its dock unlocked."""
    attempt: int = 1
    estimate: PortEstimate | None = None
    insertion: Insertion | None = None
    T_base_tcp_mated: Pose | None = None
    """Where the plug was at rest when it was mated."""
    plan: DockPlan | None = None
    """That it was mated by."""
    setback: Fault | None = None
    """Why the present attempt failed."""
    outcome: Outcome | None = None
    stopping: bool = False

    @property
    def going_on(self) -> bool:
        """Whether there is a job that has no outcome yet."""
        return self.under_way and self.outcome is None

    def result(self) -> Outcome:
        """What the job has come to, back in READY."""
        if self.stopping:
            return Outcome("stopped")
        if self.setback is not None:
            refused = self.setback.code is FaultCode.PORT_NOT_FOUND
            return Outcome("refused" if refused else "intervention-needed", self.setback)
        match self.goal:
            case Goal.UNDOCK:
                return Outcome("undocked")
            case Goal.RESET:
                return Outcome("ready")
        return Outcome("charged")


@dataclass(slots=True)
class Task:
    """One robot's work; steps read and change it."""

    cell: Cell
    config: SiteConfig
    T_port_tcp_mated: Pose
    watcher: Watcher
    state_folder: Path
    """Holds what must survive the process: the axis of an insertion."""
    desk: Desk
    looking: Looking
    now: Progress = field(default_factory=Progress)
    plan: DockPlan | None = None
    """From APPROACHING on, or recalled when the plug was found inserted."""
    charging_seen: bool = False
    """Current was measured in the present stay in CHARGING."""

    @property
    def last_attempt(self) -> bool:
        """Whether the ladder has no further rung."""
        return self.now.attempt >= self.config.mission.max_attempts

    def must(self, request: ChargerRequest) -> None:
        """Ask the charger and insist. Raises MissionFault (charger-rejected, or what silenced the charger)."""
        result = self.cell.ask(request, 5.0)
        if result in _UNANSWERED:  # a charger that is silent altogether trips, but perhaps only after this
            self.cell.supervisor.wait(lambda: False, self.config.charger.lost_ms / 1000.0 * self.cell.time_scale)
        if result is not RequestResult.DONE:
            reason = self.cell.charger.refusal() if result is RequestResult.REJECTED else ""
            detail = f"{request.name}: {result.name}" + (f", {reason}" if reason else "")
            raise MissionFault(FaultCode.CHARGER_REJECTED, detail)
