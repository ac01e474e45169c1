"""The last seconds of a bus's traffic, kept for the evidence of a loss."""

from __future__ import annotations

import threading
from collections import deque

from drivers.base import CanFrame

_MOST = 20_000
"""A flooded bus must not eat the memory."""


class TrafficTail:
    """Frames of both directions that are not older than ``seconds``; any thread may ask or add."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._frames: deque[CanFrame] = deque(maxlen=_MOST)
        self._lock = threading.Lock()

    def add(self, frame: CanFrame) -> None:
        """The newest frame."""
        with self._lock:
            self._frames.append(frame)
            while self._frames[0].time_s < frame.time_s - self._seconds:
                self._frames.popleft()

    def since(self, time_s: float) -> tuple[CanFrame, ...]:
        """What is kept of the time from then on, oldest first."""
        with self._lock:
            return tuple(frame for frame in self._frames if frame.time_s >= time_s)
