"""What waits to be written: a queue bounded in bytes, that never makes the one who hands something over wait."""

from __future__ import annotations

import threading
from collections import deque
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
