"""What the daemon is doing, for whoever asks: one snapshot, gathered from mission, supervisor and devices."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from controller.cell import Cell
from controller.faults import Fault, Outcome
from controller.states import State
from drivers.base import Clock, LinkHealth


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """One link as its driver judges it."""

    name: str
    up: bool
    detail: str
    silent_s: float | None
    """Since the last good data."""
    counters: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True)
class Status:
    """What is known at one moment."""

    state: str
    state_number: int
    in_state_s: float
    up_s: float
    job: str | None
    """The job under way."""
    fault: str | None
    remedy: str
    last_outcome: str | None
    attempts: int
    plug: str | None
    """The charger's proximity contact."""
    lock: str | None
    contactor_closed: bool | None
    current_a: float | None
    robot_mode: str | None
    safety_mode: str | None
    ticks: int
    links: tuple[LinkStatus, ...] = ()
    outcomes: tuple[tuple[str, int], ...] = ()
    faults: tuple[tuple[str, int], ...] = ()

    @property
    def healthy(self) -> bool:
        """Links up and no latched fault. A mission that asked for a person may still be the last one."""
        return self.fault is None and self.state != State.OFFLINE.name and all(link.up for link in self.links)

    def to_json(self) -> dict[str, Any]:
        """For the socket and /health."""
        values = asdict(self) | {"healthy": self.healthy}
        values["links"] = {
            link.name: {"up": link.up, "detail": link.detail, "counters": dict(link.counters)} for link in self.links
        }
        for name in ("outcomes", "faults"):
            values[name] = dict(values[name])
        return values


@dataclass(slots=True)
class _Told:
    state: State = State.OFFLINE
    since_s: float = 0.0
    fault: Fault | None = None
    job: str | None = None
    last_outcome: str | None = None
    attempts: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)


class StatusBoard:
    """The mission's thread writes on it, the socket's and the web server's read from it."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._begun_s = clock.now_s()
        self._told = _Told(since_s=self._begun_s)
        self._cell: Cell | None = None

    def attach(self, cell: Cell) -> None:
        """The live cell."""
        self._cell = cell

    def entered(self, state: State) -> None:
        """A transition."""
        with self._lock:
            self._told.state, self._told.since_s = state, self._clock.now_s()
            if state is not State.FAULT:
                self._told.fault = None

    def began(self, job: str) -> None:
        """A job left the state of rest."""
        with self._lock:
            self._told.job = job

    def ended(self, outcome: Outcome, attempts: int) -> None:
        """A job is over, or a fault came up without one."""
        with self._lock:
            told = self._told
            told.job, told.last_outcome, told.attempts = None, outcome.kind, attempts
            told.outcomes[outcome.kind] += 1
            if outcome.fault is not None:
                told.faults[outcome.fault.code.value] += 1
            if told.state is State.FAULT:
                told.fault = outcome.fault

    def status(self) -> Status:
        """A snapshot. Asks the drivers for what they have; never waits for a device."""
        now_s = self._clock.now_s()
        cell = self._cell
        arm = None if cell is None else cell.arm_state()
        charger = None if cell is None else cell.charger_status()
        with self._lock:
            told = self._told
            return Status(
                state=told.state.name,
                state_number=int(told.state),
                in_state_s=round(now_s - told.since_s, 3),
                up_s=round(now_s - self._begun_s, 3),
                job=told.job,
                fault=None if told.fault is None else told.fault.code.value,
                remedy="" if told.fault is None else f"{told.fault}. {told.fault.remedy}",
                last_outcome=told.last_outcome,
                attempts=told.attempts,
                plug=None if charger is None else charger.proximity.name,
                lock=None if charger is None else charger.lock.name,
                contactor_closed=None if charger is None else charger.contactor_closed,
                current_a=None if charger is None or charger.current_a != charger.current_a else charger.current_a,
                robot_mode=None if arm is None else arm.mode.name,
                safety_mode=None if arm is None else arm.safety.name,
                ticks=0 if cell is None else cell.supervisor.ticks,
                links=() if cell is None else tuple(_link(*link, now_s) for link in cell.healths()),
                outcomes=tuple(sorted(told.outcomes.items())),
                faults=tuple(sorted(told.faults.items())),
            )


def _link(name: str, health: LinkHealth, now_s: float) -> LinkStatus:
    silent_s = None if health.last_rx_s is None else round(max(0.0, now_s - health.last_rx_s), 3)
    return LinkStatus(name, health.up, health.detail, silent_s, health.counters)
