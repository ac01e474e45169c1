"""SICK Profiler 2 over RS-485: the host asks, the device answers, one profile in about eight questions.

The device keeps measuring; ``start`` only begins to ask. Its laser is switched by a wire, not by a command. A profile
is: its address, its header (size and time), its points in blocks, then the header's time again: if that has changed,
the device overwrote the profile while it was being read, and it is dropped. Not settled by the manual, hence
parameters: the unit of addresses, and the distance at which Y is 0. Half duplex needs an adapter that switches
direction by itself.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.base import ByteSink, Clock, CommandRejectedError, DriverError, LinkHealth, LinkLostError
from drivers.frame_format import CounterField
from drivers.scanner import profiler2_codec as codec
from drivers.scanner.counters import ClockUnwrapper
from drivers.scanner.profiler2_codec import Words
from drivers.scanner.question_line import QuestionLine
from drivers.scanner.serial_link import SerialSettings
from perception.geometry import Array
from perception.scan import Profile

logger = logging.getLogger(__name__)

NO_MEASUREMENT = 0x7FFF
HEADER_BYTES = 4
TIME = CounterField("time", 65536, 1e-4)
"""The profile's time stamp: 0.1 ms, wraps every 6.5536 s."""


@dataclass(frozen=True, slots=True)
class Profiler2Settings:
    """What differs between devices, mountings and readings of the manual."""

    reference_m: float = 0.10
    """Distance from the scanner frame's origin at which Y is 0."""
    y_away: bool = False
    """Whether Y grows away from the device."""
    thinning: int = 1
    """Take each n-th point, 1 to 15: the wire time of a whole profile at 115,200 baud is 0.3 s."""
    address_in_words: bool = False
    """Addresses count 16-bit words instead of bytes: the manual's example fits both, so try it on the device."""
    tolerant: bool = False
    answer_s: float = 0.5
    """Time-out of one answer. The device itself gives up after 2 s."""
    attempts: int = 3
    silence_s: float = 3.0
    """No profile for so long while asking: the link is lost."""


class Profiler2:
    """``drivers.base.Scanner`` for the Profiler 2."""

    def __init__(
        self,
        serial: SerialSettings,
        settings: Profiler2Settings,
        sink: ByteSink,
        clock: Clock,
        *,
        queue_profiles: int = 8192,
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._line = QuestionLine(serial, sink, clock, settings.answer_s, settings.attempts, settings.tolerant)
        self._time = ClockUnwrapper(TIME)
        self._profiles: deque[Profile] = deque(maxlen=queue_profiles)
        self._asking: threading.Thread | None = None
        self._on = False
        self._stopping = threading.Event()
        self._number = 0
        self._dropped = 0
        self._last_good_s: float | None = None
        self._started_s = 0.0
        self._failure = ""

    def open(self) -> None:
        """Open the line. Raises LinkOpenError."""
        self._line.open()

    def close(self) -> None:
        """Stop asking, close the line. Idempotent, never raises."""
        self.stop()
        self._line.close()

    def start(self) -> None:
        """Begin to ask for profiles. Raises LinkLostError if the device does not answer."""
        if self._asking is not None:
            return
        self._begin()
        self._profiles.clear()
        self._stopping.clear()
        self._failure = ""
        self._started_s = self._clock.now_s()
        self._on = True
        self._asking = threading.Thread(target=self._ask_on, name="profiler2", daemon=True)
        self._asking.start()

    def _begin(self) -> None:
        try:
            self._line.ask(codec.encode(codec.GET_PROFILE_ADDRESS), codec.GET_PROFILE_ADDRESS)
        except CommandRejectedError as error:
            raise LinkLostError(error.cause, remedy=error.remedy) from error

    def stop(self) -> None:
        """Stop asking; what was taken before can still be fetched. Idempotent, never raises."""
        self._stopping.set()
        self._on = False
        if self._asking is not None:
            self._asking.join()
            self._asking = None

    def take(self) -> list[Profile]:
        """Profiles since the last call. Raises LinkLostError for a broken line or a device that stopped answering."""
        silent_s = self._silent_s()
        reason = self._line.lost or ""
        if not reason and self._on and silent_s > self._settings.silence_s:
            reason = f"gave no profile for {silent_s:.1f} s {self._failure}".strip()
        if reason:
            raise LinkLostError(f"scanner line {self._line.device} {reason}")
        return [self._profiles.popleft() for _ in range(len(self._profiles))]

    def health(self) -> LinkHealth:
        """Up: the line is open and, while asking, profiles keep coming."""
        fresh = not self._on or self._silent_s() <= self._settings.silence_s
        counters = (*self._line.counters, ("profiles", self._number - self._dropped), ("lost", self._dropped))
        return LinkHealth(self._line.is_open and fresh, self._last_good_s, counters, self._line.lost or self._failure)

    def _silent_s(self) -> float:
        return self._clock.now_s() - max(self._started_s, self._last_good_s or 0.0)

    def _ask_on(self) -> None:
        last_time: int | None = None
        while not self._stopping.is_set() and self._line.is_open:
            try:
                last_time = self._ask_for_one(last_time)
            except Exception as error:  # a defect: the link goes silent, and says why
                logger.exception("asking for profiles")
                self._failure = f"stopped by a defect: {error!r}"
                return

    def _ask_for_one(self, last_time: int | None) -> int | None:
        """Keep the next profile, if there is a new one; its time stamp, or that of the last one that was read."""
        try:
            ticks, profile = self._profile(last_time)
        except DriverError as error:
            self._failure = error.cause
            self._number += 1  # a profile was there and is lost: the gap shows
            self._dropped += 1
            logger.warning("profile dropped: %s", error)
            return last_time
        if profile is not None:
            self._profiles.append(profile)
            self._last_good_s = self._clock.now_s()
        return ticks

    def _profile(self, last_time: int | None) -> tuple[int, Profile | None]:
        """The newest profile, None if it is the last one again. Raises DriverError if it could not be read whole."""
        reply = self._line.ask(codec.encode(codec.GET_PROFILE_ADDRESS), codec.GET_PROFILE_ADDRESS, 2)
        address = int(reply.words[0]) << 16 | int(reply.words[1])
        size, ticks, host_s = self._header(address)
        if ticks == last_time:
            return ticks, None
        if size == 0:  # after a reset there is none in its memory yet
            raise DriverError("the device has no profile yet", remedy="Wait a moment; check its exposure and trigger.")
        raw = np.concatenate(list(self._blocks(address, size)))
        if self._header(address)[1] != ticks:
            raise DriverError("the device overwrote a profile while it was read", remedy="Use a faster line or thin.")
        device_s = self._time.seconds(ticks, host_s)
        self._number += 1
        return ticks, self._decoded(raw, self._number - 1, host_s, device_s)

    def _header(self, address: int) -> tuple[int, int, float]:
        """Number of points, time stamp in ticks, and when the answer came."""
        words, host_s = self._read(address, 2, pairs=False)
        return int(words[0]) // 32, int(words[1]), host_s

    def _blocks(self, address: int, size: int) -> Iterator[Words]:
        """XY words of the whole profile, block after block."""
        step = self._settings.thinning
        for first in range(0, size, codec.MAX_POINTS_PER_READ * step):
            count = min(codec.MAX_POINTS_PER_READ, -(-(size - first) // step))
            offset = HEADER_BYTES + 4 * first
            yield self._read(address + (offset // 2 if self._settings.address_in_words else offset), count, pairs=True)[
                0
            ]

    def _read(self, address: int, count: int, *, pairs: bool) -> tuple[Words, float]:
        """Memory words from ``address``, and when they came. The echoed address tells a late answer from the right."""
        step = self._settings.thinning if pairs else 1
        expected = 2 + count * (2 if pairs else 1)
        request = codec.read_request(address, count, pairs=pairs, step=step)
        reply = self._line.ask(request, codec.READ_MEMORY, expected, (address >> 16, address & 0xFFFF))
        return reply.words[2:], reply.host_s

    def _decoded(self, raw: Words, number: int, host_s: float, device_s: float) -> Profile:
        points, quality = points_of(raw, self._settings)
        return Profile(number, host_s, device_s, points, None, quality)


def points_of(raw: Words, settings: Profiler2Settings) -> tuple[Array, float]:
    """Points (N, 2) in metres of XY words, only what was measured, and the share of it."""
    xy = raw.reshape(-1, 2)
    seen = (xy[:, 0] != NO_MEASUREMENT) & (xy[:, 1] != NO_MEASUREMENT)
    points = xy[seen].astype(np.int16).astype(np.float64)
    points *= 1e-6, 1e-6 if settings.y_away else -1e-6
    points[:, 1] += settings.reference_m
    return points, len(points) / len(seen) if len(seen) else 0.0
