"""The actuator that locks the plug in the vehicle's port: takes its time, and can jam."""

from __future__ import annotations

UNLOCKED, LOCKING, LOCKED, UNLOCKING, FAULT = "Unlocked", "Locking", "Locked", "Unlocking", "Fault"


class LockActuator:
    """Moves between two ends in ``travel_s`` emulated seconds. The position stays when the power goes."""

    def __init__(self, travel_s: float) -> None:
        self._travel_s = travel_s
        self._started_s = 0.0
        self.state = UNLOCKED
        self.jammed = False

    @property
    def moving(self) -> bool:
        """Between its ends."""
        return self.state in (LOCKING, UNLOCKING)

    @property
    def holds(self) -> bool:
        """Whether the plug cannot be pulled: in doubt it holds."""
        return self.state != UNLOCKED and self.state != LOCKING

    def lock(self, now_s: float) -> None:
        """Start towards locked."""
        self._start(LOCKING, LOCKED, now_s)

    def unlock(self, now_s: float) -> None:
        """Start towards unlocked."""
        self._start(UNLOCKING, UNLOCKED, now_s)

    def step(self, now_s: float) -> None:
        """Arrive, or jam halfway."""
        if not self.moving or now_s - self._started_s < self._travel_s:
            return
        if self.jammed:
            self.state = FAULT
        else:
            self.state = LOCKED if self.state == LOCKING else UNLOCKED

    def _start(self, moving: str, end: str, now_s: float) -> None:
        if self.state not in (moving, end):
            self.state, self._started_s = moving, now_s
