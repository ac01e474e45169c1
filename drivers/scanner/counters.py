"""Counters that wrap: a device's clock and its sequence numbers, made continuous."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.frame_format import CounterField


@dataclass
class ClockUnwrapper:
    """Device time without wraps. Whole wraps missed in a long silence are found by the host's time."""

    counter: CounterField
    _raw: int | None = None
    _ticks: int = 0
    _host_s: float = 0.0

    def seconds(self, raw: int, host_s: float) -> float:
        """Unwrapped device time of a frame that reads ``raw`` and came at ``host_s``; starts at ``raw`` itself."""
        modulus, unit = self.counter.modulus, self.counter.unit_s
        if self._raw is None:
            self._ticks = raw
        else:
            step = (raw - self._raw) % modulus
            missed = round((host_s - self._host_s - step * unit) / (modulus * unit))
            self._ticks += step + modulus * max(0, missed)
        self._raw, self._host_s = raw, host_s
        return self._ticks * unit


RESTART_AFTER = 5


@dataclass
class SequenceTracker:
    """Which frames are new, and how many are missing between them."""

    counter: CounterField
    lost: int = 0
    stale: int = 0
    """Frames that came again, or from before the last one: never handed on."""
    _raw: int | None = None
    _number: int = 0
    _stale_next: int | None = None
    _stale_run: int = 0

    def accept(self, raw: int) -> int | None:
        """The frame's number, unwrapped; None for one that is not new.

        A device whose count jumps back is believed after RESTART_AFTER frames in order.
        """
        if self._raw is None:
            return self._take(raw, raw)
        step = (raw - self._raw) % self.counter.modulus
        if 0 < step < self.counter.modulus // 2:
            self.lost += step - 1
            return self._take(raw, self._number + step)
        self._stale_run = self._stale_run + 1 if raw == self._stale_next else 1
        self._stale_next = (raw + 1) % self.counter.modulus
        if self._stale_run >= RESTART_AFTER:
            return self._take(raw, self._number + 1)
        self.stale += 1
        return None

    def restart(self) -> None:
        """Expect any number next; what was counted stays."""
        self._raw, self._stale_run = None, 0

    def _take(self, raw: int, number: int) -> int:
        self._raw, self._number, self._stale_run = raw, number, 0
        return number
