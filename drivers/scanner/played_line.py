"""A scanner's line that plays recorded bytes: what came over the wire goes through the real decoder once more."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from drivers.base import ByteSink
from drivers.frame_format import FrameFormat
from drivers.playback import Playback
from drivers.scanner.framed import FramedScanner, FramedTimeouts
from drivers.scanner.serial_link import SerialLink, SerialSettings
from perception.scan import Profile

TX = "scanner tx"
"""Cue: something was written to the line."""


class PlayedLine(SerialLink):
    """Chunks as they were read, with their times. What is written goes nowhere."""

    def __init__(
        self,
        settings: SerialSettings,
        sink: ByteSink,
        on_bytes: Callable[[bytes, int], None],
        playback: Playback,
        chunks: Sequence[tuple[int, bytes]],
    ) -> None:
        """``chunks``: (host's monotonic ns, bytes read then)."""
        super().__init__(settings, sink, on_bytes)
        self._playback = playback
        self._opened = False
        playback.play((time_ns * 1e-9, lambda c=chunk, t=time_ns: on_bytes(c, t)) for time_ns, chunk in chunks)  # type: ignore[misc]

    @property
    def is_open(self) -> bool:
        """Between ``open`` and ``close``."""
        return self._opened

    def open(self) -> None:
        """Nothing to open."""
        self._opened = True

    def close(self) -> None:
        """Nothing to close."""
        self._opened = False

    def write(self, data: bytes) -> None:
        """On to when this was written, and to where the mission went on after the answer."""
        if self._playback.next_cue_s(TX) < float("inf"):
            self._playback.did(TX)
        after_s = self._playback.next_cue_s()
        if after_s < float("inf"):
            self._playback.run_until(after_s)


class PlayedScanner(FramedScanner):
    """The real driver; of each sweep it hands over as many profiles as the recorded mission fetched."""

    def __init__(
        self,
        settings: SerialSettings,
        layout: FrameFormat,
        sink: ByteSink,
        playback: Playback,
        timeouts: FramedTimeouts,
        *,
        connect: Callable[[SerialSettings, ByteSink, Callable[[bytes, int], None]], SerialLink],
        taken: Sequence[tuple[float, int]],
    ) -> None:
        """``taken``: (time at which a sweep was over, profiles fetched for it)."""
        super().__init__(settings, layout, sink, playback, timeouts, connect=connect)
        self._playback, self._taken = playback, taken
        self._left = math.inf

    def start(self) -> None:
        """Laser on, as recorded."""
        self._left = next((count for time_s, count in self._taken if time_s > self._playback.now_s()), math.inf)
        super().start()

    def take(self) -> list[Profile]:
        """Profiles since the last call, as long as the recorded sweep took some."""
        profiles = super().take()
        kept = profiles[: int(min(self._left, len(profiles)))]
        self._left -= len(kept)
        return kept
