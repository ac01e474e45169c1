"""How the charger watches the robot: heartbeat by wall clock, counter checked, degraded at 150 ms, lost at 250 ms."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RobotView:
    """What the charger believes of the robot at this moment."""

    alive: bool
    lost: bool
    """Was heard once and is silent now, or not yet heard often enough again."""
    flags: int = 0

    @property
    def holds_plug(self) -> bool:
        """Flag 2."""
        return bool(self.flags & 1 << 2)

    @property
    def clear(self) -> bool:
        """Flag 4: clear of the vehicle."""
        return bool(self.flags & 1 << 4)

    @property
    def mated(self) -> bool:
        """Flag 5: mated, confirmed by force."""
        return bool(self.flags & 1 << 5)


class RobotWatch:
    """Counts good heartbeats and measures the silence since the last."""

    def __init__(self, lost_s: float, modulus: int | None) -> None:
        """``modulus`` None: counters are not checked."""
        self._lost_s, self._modulus = lost_s, modulus
        self._counter: int | None = None
        self._last_s: float | None = None
        self._missing_good = 3
        self._was_alive = False
        self._flags = 0

    def heartbeat(self, counter: int, flags: int, now_s: float) -> None:
        """A heartbeat with a good checksum came."""
        self._expire(now_s)
        if not self._counts(counter):
            return
        self._last_s, self._flags = now_s, flags
        self._missing_good = max(0, self._missing_good - 1)
        self._was_alive = self._was_alive or self._missing_good == 0

    def view(self, now_s: float) -> RobotView:
        """How the robot stands now."""
        self._expire(now_s)
        alive = self._missing_good == 0
        return RobotView(alive, self._was_alive and not alive, self._flags)

    def _expire(self, now_s: float) -> None:
        if self._last_s is not None and now_s - self._last_s > self._lost_s:
            self._missing_good, self._counter, self._last_s = 3, None, None

    def _counts(self, counter: int) -> bool:
        """One or two steps forward; up to half the range is a loss of frames, which still counts as hearing them."""
        if self._modulus is None:
            return True
        before, self._counter = self._counter, counter
        return (
            before is not None
            and counter < self._modulus
            and 1 <= (counter - before) % self._modulus <= (self._modulus // 2)
        )
