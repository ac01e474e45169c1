"""Monotonic time that is handed in, so that tests and replays own it."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic seconds. Injected, so that tests and replays own time."""

    def now_s(self) -> float: ...
    def sleep(self, seconds: float) -> None: ...


class MonotonicClock:
    """The host's monotonic clock."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)
