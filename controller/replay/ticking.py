"""The supervisor of a replay: the same tick, interlocks and waits, but time passes only while the mission waits.

A wait of the recording ended at a known time; within a state, the first wait here is the first one there, and so on.
Here it ends there too, if what is waited for has come by then. If it has not, the recording is played on in small steps
(the arm's samples carry the time that its clock tells, not that of their arrival: some came a little earlier), and when
that goes on for too long the two have parted.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from controller.faults import Fault, MissionFault
from controller.recording.values import Transition
from controller.replay.evidence import DECISION, STATE, WAIT
from controller.replay.story import Story
from controller.sources import Sources
from controller.states import STOPS, Event, State
from controller.supervisor import TICK_S, StopRequested, Supervisor
from drivers.base import Clock
from drivers.playback import ARM, EndOfRecording, Playback

EARLY_S = 2.0
"""What has come so much before the recording's wait ended is waited for with it."""
NEAR_S, NEAR_STEP_S = 0.05, 0.001
"""So long after the recorded end of a wait, and in such steps, what was waited for is expected at any moment."""
SILENCE_S = 6.0
"""Longer than any link may be silent."""
PATIENCE_S = 15.0
"""So long may something be overdue: a link's silence shows by its age only."""


class ReplaySupervisor(Supervisor):
    """Ticks in the mission's own thread, in recorded time."""

    def __init__(
        self, sources: Sources, mission_clock: Clock, playback: Playback, stall_s: float, story: Story
    ) -> None:
        super().__init__(sources, mission_clock, playback, stall_s)
        self._playback = playback
        playback.pass_time = self._pass_time
        self._waits_are_known = playback.next_cue_s(WAIT) < math.inf
        self.coming_fault: Callable[[], Transition | None] = lambda: None
        """The recording's next transition, if the mission only makes safe before it enters FAULT."""
        self._asked = list(story.asked)
        self._end_s = math.inf if story.complete else story.end_s
        self._at_rest = story.state in (State.READY, State.CHARGING) and story.first is not Event.CHARGE_COMPLETE
        """Where a daemon waits for what its recording then begins with: that wait is not in it."""

    def start(self) -> None:
        """No thread: time passes in ``wait``."""

    def close(self) -> None:
        """No thread."""

    def wait(self, until: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """As in the mission, in recorded time. Raises EndOfRecording when the recording has no more to say."""
        at_rest, self._at_rest = self._at_rest, False
        if at_rest and until():
            return True
        end_s = None if timeout_s is None else self._clock.now_s() + timeout_s
        recorded_s = self._playback.next_cue_s(WAIT)
        deed_s, broken_off_s = self._next_deed_s(), -math.inf
        if self._waits_are_known and deed_s < recorded_s:
            broken_off_s = deed_s + _overdue_s(self.coming_fault())
        overdue_s = min(recorded_s, self._playback.next_cue_s()) + PATIENCE_S
        while True:
            self._raise_interruptions()
            timed_out = end_s is not None and self._clock.now_s() >= end_s
            now_s = self._playback.now_s()
            if (until() or timed_out) and now_s >= broken_off_s:
                return self._let_end(until, recorded_s)
            if now_s > overdue_s:
                raise EndOfRecording("the mission goes on waiting where the recorded one went on")
            self._pass_time(_next_look_s(now_s, recorded_s))

    def _next_deed_s(self) -> float:
        """When the recorded mission decided something, or entered a state. A wait that was not over by then was broken
        off: by a trip, a stop, a pause."""
        return self._playback.next_cue_s(DECISION, STATE)

    @property
    def trip(self) -> Fault | None:
        """As in the mission. Where that tripped before it did anything else, time passes until it does here."""
        fault = self.coming_fault()
        if fault is not None and fault.time_s < self._playback.next_cue_s(WAIT):
            end_s = self._next_deed_s() + _overdue_s(fault)
            while self._trip is None and self._playback.now_s() < end_s:
                self._pass_time(min(self._playback.now_s() + TICK_S, end_s))
        return self._trip

    @property
    def tripped_meanwhile(self) -> bool:
        """As in the mission: one that stopped the arm once more before it entered FAULT had tripped by then."""
        fault = self.coming_fault()
        if fault is not None and self._playback.next_cue_s(ARM) < fault.time_s:
            return self.trip is not None
        return self._trip is not None

    def _let_end(self, until: Callable[[], bool], recorded_s: float) -> bool:
        """Stay until the recorded end of the wait if it is near, and look once more at what came meanwhile."""
        if recorded_s <= self._playback.now_s() + EARLY_S:
            self._playback.did(WAIT)
        else:
            self._playback.skip_cue(WAIT)
        return until()

    def _raise_interruptions(self) -> None:
        state = self._facts.state
        if self._trip is not None:
            raise MissionFault(self._trip.code, self._trip.detail)
        if self._request.stop and (state, Event.STOP) in STOPS:
            raise StopRequested
        self.raise_if_paused()

    def wait_ticks(self, count: int) -> None:
        """Let ``count`` ticks pass, not beyond the end of the wait that follows. Raises MissionFault as one trips.

        The recorded mission's ticks may have come closer together: a wake makes one come early.
        """
        for _ in range(count):
            next_s = self._playback.next_cue_s(WAIT)
            self._pass_time(min(self._playback.now_s() + TICK_S, max(next_s, self._playback.now_s())))
            if self._trip is not None:
                raise MissionFault(self._trip.code, self._trip.detail)
        if (trip := self.trip) is not None:
            raise MissionFault(trip.code, trip.detail)

    def idle(self, until: Callable[[], bool]) -> None:
        """Let time pass, whatever is latched."""
        overdue_s = self._playback.next_cue_s() + PATIENCE_S
        while not until():
            if self._playback.now_s() > overdue_s:
                raise EndOfRecording("the mission rests where the recorded one went on")
            self._pass_time(self._playback.now_s() + TICK_S)

    def _pass_time(self, to_s: float) -> None:
        if to_s > self._end_s:
            raise EndOfRecording("the recording was cut off here")
        self._playback.run_until(to_s)
        while self._asked and self._asked[0].time_s <= to_s:
            if self._asked.pop(0).abort:
                self.request_abort()
            else:
                self.request_stop()
        self._tick()

    def _late_s(self, due_s: float) -> float:
        return 0.0  # ticks come when the replay lets them: that the recorded process stalled is not played back


def _overdue_s(fault: Transition | None) -> float:
    """How much later than recorded a fault may come: a cable that was pulled shows here by silence only."""
    return SILENCE_S if fault is not None and fault.event == Event.LINK_LOST.value else 0.0


def _next_look_s(now_s: float, recorded_s: float) -> float:
    """When a wait looks next at what it waits for: each tick, at its recorded end, and often soon after that."""
    if now_s < recorded_s:
        return min(now_s + TICK_S, recorded_s)
    return now_s + (NEAR_STEP_S if now_s < recorded_s + NEAR_S else TICK_S)
