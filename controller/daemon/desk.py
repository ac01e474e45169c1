"""The desk between clients and mission: takes one job at a time, passes stop and abort on, says when to leave.

Clients' requests come from the socket's thread, the mission looks from its own; results go out through ``publish``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Protocol

from controller.daemon.protocol import Answer, Event, Request, ResultEvent
from controller.faults import Outcome
from controller.states import RESTING, State
from controller.task import Goal

GOALS = {Request.DOCK: Goal.DOCK, Request.UNDOCK: Goal.UNDOCK, Request.RESET: Goal.RESET}


class Interrupts(Protocol):
    """What of the supervisor is needed here."""

    def request_stop(self) -> None: ...
    def request_abort(self) -> None: ...
    def clear_stop(self) -> None: ...


class JobDesk:
    """``controller.task.Desk`` for clients."""

    def __init__(self, publish: Callable[[Event], None]) -> None:
        self._publish = publish
        self._lock = threading.Lock()
        self._interrupts: Interrupts | None = None
        self._state: Callable[[], State] = lambda: State.OFFLINE
        self._pending: Goal | None = None
        self._job = 0
        self._under_way = False
        self._leaving = False
        self.summary: dict[str, Any] = {}
        """Of the mission that is just ending; set before ``answered``."""

    def open(self, interrupts: Interrupts, state: Callable[[], State]) -> None:
        """From here on jobs are accepted."""
        with self._lock:
            self._interrupts, self._state = interrupts, state

    # --- the mission's side -------------------------------------------------------------------------------------------

    @property
    def pending(self) -> Goal | None:
        """The job that waits to be taken."""
        return self._pending

    @property
    def leaving(self) -> bool:
        """Whether the process is to end."""
        return self._leaving

    def take(self) -> Goal:
        """The mission takes the job up."""
        with self._lock:
            goal, self._pending = self._pending, None
            assert goal is not None
            return goal

    def answered(self, outcome: Outcome) -> None:
        """The mission says what became of the job, or of what it did by itself."""
        with self._lock:
            job = self._job if self._under_way and self._pending is None else None
            self._under_way = self._under_way and job is None
            summary, self.summary = self.summary, {}
        fault = outcome.fault
        remedy = "" if fault is None else f"{fault}. {fault.remedy}"
        self._publish(ResultEvent(job, outcome.kind, None if fault is None else fault.code.value, remedy, summary))

    # --- the clients' side --------------------------------------------------------------------------------------------

    def submit(self, request: Request) -> Answer:
        """A job, a stop or an abort."""
        with self._lock:
            if self._interrupts is None:
                return Answer("refused", reason="the daemon is still opening its devices")
            if self._leaving and request is not Request.ABORT:
                return Answer("refused", reason="the daemon is ending")
            if request in GOALS:
                return self._accept(GOALS[request])
            if request is Request.ABORT:
                if self._state() is State.FAULT and not self._under_way:  # no result would follow
                    return Answer("nothing-to-do", reason="in FAULT nothing moves")
                self._interrupts.request_abort()
                return Answer("accepted", self._job if self._under_way else None)
            return self._stop()

    def _accept(self, goal: Goal) -> Answer:
        if self._under_way:
            return Answer("refused", self._job, f"job {self._job} is under way; see `portdock status`")
        if self._interrupts is not None and self._state() in RESTING:
            self._interrupts.clear_stop()  # one that came while the last job ended
        self._job += 1
        self._pending, self._under_way = goal, True
        return Answer("accepted", self._job)

    def _stop(self) -> Answer:
        assert self._interrupts is not None
        if not self._under_way and self._state() in RESTING | {State.SELF_CHECK}:
            return Answer("nothing-to-do", reason=f"nothing is under way in {self._state().name}")
        self._interrupts.request_stop()
        return Answer("accepted", self._job if self._under_way else None)

    # --- the end ------------------------------------------------------------------------------------------------------

    def leave(self) -> None:
        """End the process: at once from a state of rest, after a stop that finishes safely from any other."""
        with self._lock:
            self._leaving = True
            state = self._state()
            begins = state is State.READY and self._under_way
            if self._interrupts is not None and (begins or state not in RESTING | {State.CHARGING}):
                self._interrupts.request_stop()

    def leave_now(self) -> None:
        """End the process with motion frozen."""
        with self._lock:
            self._leaving = True
            if self._interrupts is not None:
                self._interrupts.request_abort()
