"""Scanners of a replay: the real drivers on played lines, which hand over as much as the recorded mission took.

How many profiles a sweep took is decided by when its motion ended and its queue was emptied; to the millisecond that is
no recorded fact, the number is.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from functools import partial

from drivers.base import ByteSink, LinkHealth, LinkOpenError, NullSink, Scanner
from drivers.playback import Playback
from drivers.scanner import scip_codec
from drivers.scanner.played_line import Dialogue, PlayedLine
from drivers.scanner.profiler2 import Profiler2, Profiler2Settings
from drivers.scanner.question_line import QuestionLine
from drivers.scanner.scip import ScipScanner, ScipSettings, geometry_of
from drivers.scanner.serial_link import SerialSettings
from perception.scan import Profile

Taken = Sequence[tuple[float, int]]
"""(host's time at which a sweep was over, profiles that it took) of each sweep."""


def _over_next(taken: Taken, now_s: float) -> tuple[float, float]:
    """When the sweep that begins now is over and how many profiles it takes; inf, inf after the last recorded one."""
    return next(((time_s, count) for time_s, count in taken if time_s > now_s), (math.inf, math.inf))


class PlayedScanner:
    """``drivers.base.Scanner``: a driver that is handed recorded bytes, and no more profiles than were taken."""

    def __init__(self, driver: Scanner, playback: Playback, taken: Taken) -> None:
        self._driver, self._playback, self._taken = driver, playback, taken
        self._left = math.inf

    def open(self) -> None:
        """As the driver."""
        self._driver.open()

    def close(self) -> None:
        """As the driver."""
        self._driver.close()

    def start(self) -> None:
        """As the driver, for the sweep that is over next."""
        _, self._left = _over_next(self._taken, self._playback.now_s())
        self._driver.start()

    def stop(self) -> None:
        """As the driver."""
        self._driver.stop()

    def take(self) -> list[Profile]:
        """Profiles since the last call, as long as the recorded sweep took some."""
        profiles = self._driver.take()
        kept = profiles[: int(min(self._left, len(profiles)))]
        self._left -= len(kept)
        return kept

    def health(self) -> LinkHealth:
        """As the driver."""
        return self._driver.health()


class PlayedScip(ScipScanner):
    """A range finder whose geometry is in the recording; the mission's recording may begin long after its opening."""

    def __init__(
        self, serial: SerialSettings, settings: ScipSettings, sink: ByteSink, playback: Playback, dialogue: Dialogue
    ) -> None:
        line = partial(PlayedLine, playback=playback, dialogue=dialogue)
        super().__init__(serial, settings, sink, playback, connect=line)
        self._heard = dialogue.rx

    def open(self) -> None:
        """Learn the geometry from what is recorded. Raises LinkOpenError where it is not."""
        reader = scip_codec.ReplyReader()
        replies = (reply for _, chunk in self._heard for reply in reader.feed(chunk))
        geometry = next((reply for reply in replies if reply.echo == "PP"), None)
        if geometry is None:
            raise LinkOpenError(
                "the range finder's parameters (PP) are not in the recording",
                remedy="It cannot be replayed; `portdock recording export` reads what it holds.",
            )
        self._geometry = geometry_of(geometry)
        self._link.open()


class _DialogueTime(Playback):
    """Moves on by what was said alone: the pauses between answer and question are in its times already."""

    def sleep(self, seconds: float) -> None:
        """Nothing: an answer that came within the pause would be thrown away as a stray."""


class PlayedProfiler2(Profiler2):
    """A Profiler 2 whose questions are asked again at once when a sweep begins; its profiles come when they came."""

    def __init__(
        self,
        serial: SerialSettings,
        settings: Profiler2Settings,
        playback: Playback,
        dialogue: Dialogue,
        taken: Taken,
    ) -> None:
        super().__init__(serial, settings, NullSink(), playback)
        self._serial, self._dialogue, self._taken = serial, dialogue, taken
        self._playback = playback
        self._due: deque[tuple[float, Profile]] = deque()
        """Profiles with the times of their last bytes."""
        self._heard_s = [time_ns * 1e-9 for time_ns, _ in dialogue.rx]

    def open(self) -> None:
        """Nothing is asked before the first sweep."""
        self._play(_DialogueTime(self._playback.now_s()), Dialogue(self._dialogue.name, (), ()))

    def _play(self, own: Playback, dialogue: Dialogue) -> None:
        asked, line = self._settings, partial(PlayedLine, playback=own, dialogue=dialogue)
        self._line = QuestionLine(
            self._serial, NullSink(), own, asked.answer_s, asked.attempts, asked.tolerant, connect=line
        )
        self._line.open()

    def close(self) -> None:
        """Nothing to close."""

    def start(self) -> None:
        """Read the whole sweep that is over next, in a time of its own."""
        now_s = self._playback.now_s()
        end_s, _ = _over_next(self._taken, now_s)
        own = _DialogueTime(now_s)
        self._play(own, self._dialogue.between(now_s, end_s))
        self._profiles.clear()
        self._due.clear()
        last_time: int | None = None
        self._begin()
        while math.isfinite(own.next_cue_s()):
            last_time = self._ask_for_one(last_time)
            heard_s = self._heard_s[bisect_right(self._heard_s, own.now_s()) - 1]
            self._due.extend((heard_s, profile) for profile in self._profiles)
            self._profiles.clear()
        self._started_s, self._on = now_s, True

    def stop(self) -> None:
        """Nothing is asked any more."""
        self._on = False

    def take(self) -> list[Profile]:
        """As the driver, of what had come by now."""
        while self._due and self._due[0][0] <= self._playback.now_s():
            self._last_good_s, profile = self._due.popleft()
            self._profiles.append(profile)
        return super().take()
