"""Time as the mission counts it. In a dry run with ``--fast`` emulated time runs faster than wall time.

Deadlines and durations of the procedure count emulated seconds. What guards the host (freshness of a link, heartbeats,
the watchdog) always counts wall seconds: a busy host is not faster because the emulated arm is.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.base import Clock, MonotonicClock


@dataclass(frozen=True, slots=True)
class PacedClock:
    """A clock that runs ``factor`` times as fast as the one below it; ``factor`` 1 on a real cell."""

    factor: float = 1.0
    below: Clock = field(default_factory=MonotonicClock)

    def now_s(self) -> float:
        return self.below.now_s() * self.factor

    def sleep(self, seconds: float) -> None:
        self.below.sleep(seconds / self.factor)
