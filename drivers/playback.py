"""Recorded time for stand-ins that play a recording back: a clock that runs on demand, and what happens as it runs.

Nothing here is in real time and nothing runs in a thread: whoever waits moves the clock, and everything that was
recorded up to there is delivered, in the order of its time stamps. *Cues* are the recorded times of what the mission
itself did (decisions, calls to a device): when it does the same again, the clock jumps there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from heapq import merge
from itertools import takewhile

Deliver = Callable[[], None]

ARM = "arm"
"""Cue: a command was given to the arm."""


class EndOfRecording(BaseException):
    """More is asked for than was recorded. No ``Exception``: no handler of a fault takes it for one."""


class Playback:
    """``drivers.base.Clock`` of a replay."""

    def __init__(self, start_s: float) -> None:
        self._now_s = start_s
        self._due: deque[tuple[float, int, Deliver]] = deque()
        self._cues: dict[str, deque[float]] = {}
        self._streams = 0
        self.pass_time: Callable[[float], None] = self.run_until
        """How time passes while a device holds up its caller: whoever ticks meanwhile goes on ticking."""

    def now_s(self) -> float:
        """Recorded time of the host's monotonic clock."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Time passes at once."""
        self.run_until(self._now_s + seconds)

    # --- what was recorded --------------------------------------------------------------------------------------------

    def play(self, items: Iterable[tuple[float, Deliver]]) -> None:
        """Deliver each item once its time has come; items in order of time."""
        self._streams += 1
        number = self._streams
        added = [(time_s, number, deliver) for time_s, deliver in items]
        self._due = deque(merge(self._due, added, key=lambda item: item[:2]))

    def cue(self, kind: str, times_s: Iterable[float]) -> None:
        """The times at which the mission did something of this kind."""
        self._cues[kind] = deque(times_s)

    # --- moving on ----------------------------------------------------------------------------------------------------

    def run_until(self, time_s: float) -> None:
        """Let the time pass, never back, and deliver what was recorded meanwhile."""
        while self._due and self._due[0][0] <= time_s:
            at_s, _, deliver = self._due.popleft()
            self._now_s = max(self._now_s, at_s)
            deliver()
        self._now_s = max(self._now_s, time_s)

    def did(self, kind: str) -> None:
        """The mission does the next thing of this kind: on to when it was done. Raises EndOfRecording."""
        left = self._cues.get(kind)
        if not left:
            raise EndOfRecording(kind)
        self.run_until(left.popleft())

    def next_cue_s(self, *kinds: str) -> float:
        """When the mission did the next thing, of these kinds or (none named) of any; inf after the last."""
        queues = (self._cues.get(kind, deque()) for kind in kinds) if kinds else self._cues.values()
        return min((times[0] for times in queues if times), default=math.inf)

    def skip_cues(self, kind: str, before_s: float) -> None:
        """Forget cues of this kind that lie before a recorded time."""
        left = self._cues.get(kind, deque())
        for _ in list(takewhile(lambda time_s: time_s < before_s, left)):
            left.popleft()

    def skip_cue(self, kind: str) -> None:
        """Forget the next cue of this kind, if there is one: it was done at another time than in the recording."""
        left = self._cues.get(kind)
        if left:
            left.popleft()
