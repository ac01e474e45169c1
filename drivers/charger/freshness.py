"""Is the charger alive? Judged by good frames alone; pure, time is passed in."""

from __future__ import annotations

import enum


class Liveness(enum.Enum):
    """What the silence since the last good frame means."""

    WAITING = "waiting for the first frame"
    ALIVE = "alive"
    DEGRADED = "degraded"
    LOST = "lost"
    RECOVERING = "recovering"


class Freshness:
    """Degraded after some silence, lost after more; back after several good frames without a gap."""

    def __init__(self, degraded_s: float, lost_s: float, recovery_frames: int) -> None:
        self._degraded_s, self._lost_s, self._recovery_frames = degraded_s, lost_s, recovery_frames
        self.last_s: float | None = None
        self.losses = 0
        self.late = 0
        """Good frames that came after the silence counted as degraded, lost ones included."""
        self._good_since_loss: int | None = None

    def good(self, now_s: float) -> None:
        """A good frame came."""
        self._note_silence(now_s)
        if self.last_s is not None and now_s - self.last_s > self._degraded_s:
            self.late += 1
        if self._good_since_loss is not None:
            self._good_since_loss += 1
            if self._good_since_loss >= self._recovery_frames:
                self._good_since_loss = None
        self.last_s = now_s

    def bad(self) -> None:
        """A bad frame came: good frames in a row start again."""
        if self._good_since_loss is not None:
            self._good_since_loss = 0

    def at(self, now_s: float) -> Liveness:
        """How it stands now."""
        self._note_silence(now_s)
        if self.last_s is None:
            return Liveness.WAITING
        if self._good_since_loss is not None:
            return Liveness.RECOVERING if self._good_since_loss else Liveness.LOST
        return Liveness.DEGRADED if now_s - self.last_s > self._degraded_s else Liveness.ALIVE

    def _note_silence(self, now_s: float) -> None:
        if self.last_s is None or now_s - self.last_s <= self._lost_s:
            return
        if self._good_since_loss is None:
            self.losses += 1
        self._good_since_loss = 0
