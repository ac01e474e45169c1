"""The periodic tick: freshness, interlocks and deadlines, 100 times a second. Owns stop authority and all heartbeats.

Each tick looks at the links, decides by ``assess`` (pure) whether anything forbids going on, and only then kicks the
arm's watchdog. The first trip is latched: the arm is stopped at once, the mission is woken and ends in FAULT. While a
trip stands the watchdog is not kicked and the heartbeat says fault, so that arm and charger fall back on their own
supervision even if this process does nothing more.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from controller.faults import Fault, FaultCode, MissionFault
from controller.heartbeat import HEARTBEAT_S, Facts, Rhythm, beat
from controller.interlocks import Snapshot, assess, pause_reason
from controller.sources import Sources
from controller.states import PAUSES, STOPS, Event, State
from drivers.base import Clock, DriverError
from perception.errors import PortdockError

log = logging.getLogger(__name__)

TICK_S = 0.01
HALT_S = 1.0
"""The longest that a stop takes to be given; the arm does not back off after a stop that is still to come."""


class StopRequested(Exception):
    """Raised by ``wait`` in a state that a stop request ends."""


class PauseRequested(Exception):
    """Raised by ``wait`` in a state that can pause; the text says why."""


@dataclass(slots=True)
class _Request:
    stop: bool = False
    abort: bool = False


class Supervisor:
    """Runs the tick in its own thread from ``start`` to ``close``."""

    def __init__(
        self,
        sources: Sources,
        mission_clock: Clock,
        wall_clock: Clock,
        stall_s: float = 0.5,
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        """``stall_s``: a tick later than this trips what moves. ``alive`` is told with every heartbeat (systemd)."""
        self._alive = alive
        self.on_waited: Callable[[float], None] = lambda time_s: None
        """Told, when a wait ends, the wall time at which its end was seen: a recorder's."""
        self._stall_s = stall_s
        self._sources = sources
        self._clock = mission_clock
        self._wall = wall_clock
        self._facts = Facts()
        self._request = _Request()
        self._trip: Fault | None = None
        self._halted = False
        """Whether the arm has been told to stop since the trip."""
        self._backing_off = False
        self._rhythm = Rhythm(wall_clock, HEARTBEAT_S, 0.5 * TICK_S)
        self._ticks = 0
        self._begun_s = wall_clock.now_s()
        """When the newest tick began."""
        self._wake = threading.Event()
        self._ended = threading.Event()
        self._changed = threading.Condition()
        self._seen: Snapshot | None = None
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    # --- life

    def start(self) -> None:
        """Begin to tick."""
        self._thread.start()

    def close(self) -> None:
        """End the tick; from here on the arm's watchdog is not kicked any more. Idempotent."""
        self._ended.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)

    # --- what others tell it

    def enter(self, state: State, stay_s: float | None, facts: Facts | None = None) -> None:
        """The mission entered ``state`` and may stay ``stay_s`` seconds (None: as long as it takes)."""
        with self._changed:
            known = facts or self._facts
            known.state = state
            known.deadline_s = None if stay_s is None else self._clock.now_s() + stay_s
            self._facts = known

    @property
    def facts(self) -> Facts:
        """What the heartbeat tells; the mission changes it in place."""
        return self._facts

    def wake(self) -> None:
        """Tick at once: something came in that cannot wait. From any thread."""
        self._wake.set()

    def request_stop(self) -> None:
        """Finish safely, soon."""
        self._request.stop = True
        self._wake.set()

    def request_abort(self) -> None:
        """Freeze motion now and latch FAULT."""
        self._request.abort = True
        self._wake.set()

    def clear_stop(self) -> None:
        """A stop has been carried out, or there was nothing to stop."""
        self._request.stop = False

    def reset(self) -> None:
        """An operator's reset: forget the latched trip."""
        with self._changed:
            self._trip, self._halted = None, False

    def forget_requests(self) -> None:
        """Stops and aborts from before this moment."""
        self._request = _Request()

    @property
    def trip(self) -> Fault | None:
        """The latched trip."""
        return self._trip

    @property
    def tripped_meanwhile(self) -> bool:
        """Whether there is a trip now that a command has been given."""
        return self._trip is not None

    @property
    def ticks(self) -> int:
        """How many ticks there have been."""
        return self._ticks

    @property
    def pause(self) -> str | None:
        """Why the mission should be in HOLD now."""
        return None if self._seen is None else pause_reason(self._seen)

    def wait(self, until: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Wait for ``until``, looked at each tick; False after ``timeout_s`` of mission time.

        Raises MissionFault on a trip; StopRequested and PauseRequested in states that they end.
        """
        end_s = None if timeout_s is None else self._clock.now_s() + timeout_s
        with self._changed:
            while True:
                if self._trip is not None:
                    raise MissionFault(self._trip.code, self._trip.detail)
                state = self._facts.state
                if self._request.stop and (state, Event.STOP) in STOPS:
                    raise StopRequested
                self.raise_if_paused()
                seen_s = self._wall.now_s()
                if until():
                    self.on_waited(seen_s)
                    return True
                if end_s is not None and self._clock.now_s() >= end_s:
                    self.on_waited(seen_s)
                    return False
                self._changed.wait(timeout=0.1)

    def raise_if_paused(self) -> None:
        """Raises PauseRequested while there is a reason to pause, in a state that can."""
        if self.pause is not None and (self._facts.state, Event.PAUSED) in PAUSES:
            raise PauseRequested(self.pause)

    def idle(self, until: Callable[[], bool]) -> None:
        """Wait for ``until``, looked at each tick, whatever is latched: for FAULT, which only a person ends."""
        with self._changed:
            while not until():
                self._changed.wait(timeout=0.1)

    @contextmanager
    def backing_off(self) -> Iterator[Callable[[], bool]]:
        """Inside, the charger's silence alone does not keep the watchdog from being kicked, so that the arm can move.

        Yields whether that still holds: anything else that trips stops the arm and ends it. The trip stays latched.
        """
        with self._changed:
            lost = self._trip is not None and self._trip.code is FaultCode.CHARGER_LINK_LOST
            # The stop that the trip itself makes is given first, or it would end the motion that begins now.
            self._backing_off = lost and self._changed.wait_for(lambda: self._halted, timeout=HALT_S)
        try:
            yield lambda: self._backing_off
        finally:
            self._backing_off = False

    @property
    def lets_back_off(self) -> bool:
        """Whether ``backing_off`` holds just now."""
        return self._backing_off

    def wait_ticks(self, count: int) -> None:
        """Wait until ``count`` further ticks have looked at everything. Raises MissionFault as soon as one trips."""
        with self._changed:
            last = self._ticks + count
            while self._ticks < last and self._thread.is_alive():
                if self._trip is not None:
                    raise MissionFault(self._trip.code, self._trip.detail)
                self._changed.wait(timeout=0.1)

    # --- the tick

    def _run(self) -> None:
        due_s = self._begun_s = self._wall.now_s()
        while not self._ended.is_set():
            try:
                self._tick()
            except Exception:
                log.exception("the supervisor's tick failed")
                self._latch(Fault(FaultCode.INTERNAL, "the supervisor's tick failed"))
            if self._wall.now_s() >= due_s:  # else it was woken early: the next one is due when it was before
                due_s = max(due_s + TICK_S, self._wall.now_s())
            self._wake.wait(timeout=max(0.0, due_s - self._wall.now_s()))
            self._wake.clear()

    def _tick(self) -> None:
        before_s, self._begun_s = self._begun_s, self._wall.now_s()
        seen = self._look(before_s + TICK_S)
        backing_off = self._backing_off
        fault = Fault(FaultCode.ABORTED, "by request") if self._request.abort else assess(seen, backing_off)
        if fault is not None:
            self._end_backing_off(fault)
            self._latch(fault)
        elif (self._trip is None or backing_off) and seen.state not in (State.OFFLINE, State.FAULT):
            self._kick_watchdog()
        if self._rhythm.is_due():
            self._send_heartbeat(seen)
            self._alive()
        self._ticks += 1
        with self._changed:
            self._seen = seen
            self._changed.notify_all()

    def _look(self, due_s: float) -> Snapshot:
        """What there is to see, and how long after ``due_s`` it was seen.

        A process that does not run for a while may stop anywhere, inside a tick too: the time counts from the tick
        before until the links have been asked, or their silence meanwhile would be taken for the fault.
        """
        seen = self._sources.seen(self._facts, self._clock.now_s())
        return replace(seen, late_s=self._late_s(due_s), stall_s=self._stall_s)

    def _late_s(self, due_s: float) -> float:
        return max(0.0, self._wall.now_s() - due_s)

    def _latch(self, fault: Fault) -> None:
        """Stop the arm at once; keep the first trip."""
        with self._changed:
            if self._trip is not None:
                return
            self._trip = fault
            self._changed.notify_all()
        self._stop_arm()
        with self._changed:
            self._halted = True
            self._changed.notify_all()
        log.error("trip in %s: %s", self._facts.state.name, fault)

    def _end_backing_off(self, fault: Fault) -> None:
        if not self._backing_off:
            return
        self._backing_off = False
        self._stop_arm()
        log.error("backing off ends: %s", fault)

    def _stop_arm(self) -> None:
        try:
            self._sources.arm.stop()
        except PortdockError as error:
            log.error("the arm did not take the stop: %s; its watchdog stops it", error)

    def _kick_watchdog(self) -> None:
        try:
            self._sources.arm.kick_watchdog()
        except DriverError as error:
            self._latch(Fault(FaultCode.ARM_LINK_LOST, error.cause))

    def _send_heartbeat(self, seen: Snapshot) -> None:
        try:
            self._sources.charger.heartbeat(beat(self._facts, seen, self._trip is not None))
        except DriverError as error:
            log.debug("heartbeat not sent: %s", error)  # the charger's silence trips through status()
