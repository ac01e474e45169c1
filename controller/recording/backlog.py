"""What waits to be written: a queue bounded in bytes that never makes a producer wait, and a tally of what it lost."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Backlog(Generic[T]):
    """First in, first out; many producers, one consumer."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._items: deque[T] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        self._wake = threading.Event()

    def offer(self, item: T, size_bytes: int) -> bool:
        """Queue a sample, or answer False when the backlog is full."""
        with self._lock:
            if self._bytes + size_bytes > self._limit_bytes:
                return False
            self._bytes += size_bytes
            self._items.append(item)
        return True

    def put(self, item: T) -> None:
        """Queue something that must not be lost; does not count towards the limit."""
        with self._lock:
            self._items.append(item)

    def wake(self) -> None:
        """Let a waiting ``take_all`` return at once."""
        self._wake.set()

    def take_all(self, wait_s: float) -> deque[T]:
        """Everything queued, after at most ``wait_s`` of letting it gather."""
        if wait_s > 0.0:
            self._wake.wait(wait_s)
        self._wake.clear()
        with self._lock:
            items, self._items, self._bytes = self._items, deque(), 0
        return items


class Tally:
    """Numbers the messages of each topic, also the lost ones, so that a gap in the numbers shows where; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._numbers: Counter[str] = Counter()
        self._lost: Counter[str] = Counter()

    def next_number(self, topic: str) -> int:
        """0, 1, 2, ... for each topic."""
        with self._lock:
            number = self._numbers[topic]
            self._numbers[topic] = number + 1
        return number

    def lose(self, topic: str) -> None:
        """One more message of this topic is lost."""
        with self._lock:
            self._lost[topic] += 1

    @property
    def lost(self) -> int:
        """Lost messages that nobody has taken note of."""
        with self._lock:
            return self._lost.total()

    def take_lost(self) -> Counter[str]:
        """Lost messages by topic since the last call."""
        with self._lock:
            lost, self._lost = self._lost, Counter()
        return lost
