"""Emulated seconds: the world's own when there is one, else a multiple of the wall clock's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EmulatedClock:
    """Time as the emulated device lives it."""

    now_s: Callable[[], float]
    scale: float = 1.0
    """Emulated seconds per wall second."""

    @staticmethod
    def of_wall(scale: float = 1.0) -> EmulatedClock:
        """A clock that starts at 0 now."""
        began_s = time.monotonic()
        return EmulatedClock(lambda: (time.monotonic() - began_s) * scale, scale)

    def wall_s(self, emulated_s: float) -> float:
        """How long the wall clock takes for so many emulated seconds."""
        return emulated_s / self.scale
