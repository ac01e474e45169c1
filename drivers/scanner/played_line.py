"""A scanner's line that plays recorded bytes: what came over the wire goes through the real decoder once more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.base import ByteSink
from drivers.playback import Playback
from drivers.scanner.serial_link import OnBytes, SerialLink, SerialSettings


@dataclass(frozen=True, slots=True)
class Dialogue:
    """What went over one line: chunks as they were read or written, with the host's monotonic ns, in order of time."""

    name: str
    """Of the line: what is written to it are the playback's cues of this kind."""
    rx: Sequence[tuple[int, bytes]]
    tx: Sequence[tuple[int, bytes]]

    def between(self, after_s: float, until_s: float) -> Dialogue:
        """The part of it after one time and up to another."""
        parts = ([c for c in side if after_s < c[0] * 1e-9 <= until_s] for side in (self.rx, self.tx))
        return Dialogue(self.name, *parts)


class PlayedLine(SerialLink):
    """Chunks as they were read, with their times. What is written goes nowhere."""

    def __init__(
        self, settings: SerialSettings, sink: ByteSink, on_bytes: OnBytes, playback: Playback, dialogue: Dialogue
    ) -> None:
        super().__init__(settings, sink, on_bytes)
        self._playback, self._name = playback, dialogue.name
        self._opened = False
        self._last_s = dialogue.rx[-1][0] * 1e-9 if dialogue.rx else 0.0
        begun_s = playback.now_s()
        playback.cue(self._name, [time_ns * 1e-9 for time_ns, _ in dialogue.tx if time_ns * 1e-9 >= begun_s])
        playback.play((time_ns * 1e-9, lambda c=chunk, t=time_ns: on_bytes(c, t)) for time_ns, chunk in dialogue.rx)  # type: ignore[misc]

    @property
    def is_open(self) -> bool:
        """Between ``open`` and ``close``."""
        return self._opened

    @property
    def may_answer(self) -> bool:
        """No: an answer that was recorded has come by the time ``write`` returns."""
        return False

    def open(self) -> None:
        """Nothing to open."""
        self._opened = True

    def close(self) -> None:
        """Nothing to close."""
        self._opened = False

    def write(self, data: bytes) -> None:
        """On to when this was written, and to where the mission went on after the answer."""
        if self._playback.next_cue_s(self._name) < math.inf:
            self._playback.did(self._name)
        after_s = self._playback.next_cue_s()
        self._playback.run_until(after_s if after_s < math.inf else self._last_s)
