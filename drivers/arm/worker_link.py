"""The worker's end of the line to its parent: sorted input, locked output, and the beat that proves it alive."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from drivers.arm import messages as m

BEAT_S = 0.01
LINK_LOST = "the controller closed the control link"
GO_AWAY_S = 0.5
"""How long the main thread may take to stop the arm once the parent is gone."""


class Link:
    """One socket pair's end, used by the main thread and by the beat."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._requests: deque[m.Request] = deque()
        self._kicked = False
        self._busy: tuple[str, float] = ("", 0.0)
        self._alive: Callable[[], bool] = lambda: True
        self._parent = os.getppid()

    def start_beat(self) -> None:
        """Begin to beat, from a thread of its own: the main thread may be inside a long call."""
        threading.Thread(target=self._beat, daemon=True).start()

    def guard(self, alive: Callable[[], bool]) -> None:
        """End this process as soon as ``alive`` says no, even while the main thread is inside a call."""
        self._alive = alive

    def _beat(self) -> None:
        while os.getppid() == self._parent:
            if not self._alive():
                self.send(m.Ended(LINK_LOST))
                os._exit(1)
            name, since_s = self._busy
            try:
                self.send(m.Beat(name, time.monotonic() - since_s if name else 0.0))
            except OSError:
                break
            time.sleep(BEAT_S)
        time.sleep(GO_AWAY_S)  # the main thread sees the end of its input and stops the arm, unless it hangs
        os._exit(2)

    def receive(self) -> Any:
        """Next message, waiting for it."""
        return self._connection.recv()

    def fill(self, timeout_s: float) -> None:
        """Take in what has arrived; wait at most ``timeout_s`` if there was nothing. Raises EOFError."""
        while self._connection.poll(0.0 if self._requests or self._kicked else timeout_s):
            message = self._connection.recv()
            if isinstance(message, m.Kick):
                self._kicked = True
            else:
                self._requests.append(message)

    def take_kick(self) -> bool:
        """Whether the parent asked for a kick since the last look; several that piled up are one."""
        kicked, self._kicked = self._kicked, False
        return kicked

    def take_request(self) -> m.Request | None:
        """The oldest request, or None. A stop goes before all others, which are then void."""
        for index, request in enumerate(self._requests):
            if isinstance(request.command, m.Stop | m.Quit) and index > 0:
                for skipped in range(index):
                    self.send(m.Reply(self._requests[skipped].number, "refused", "stopped before it began"))
                for _ in range(index):
                    self._requests.popleft()
                break
        return self._requests.popleft() if self._requests else None

    def stop_waits(self) -> bool:
        """Whether a stop has arrived that is not taken yet."""
        return any(isinstance(request.command, m.Stop | m.Quit) for request in self._requests)

    def busy(self, name: str) -> None:
        """Note what the main thread is in, "" for nothing."""
        self._busy = (name, time.monotonic())

    def send(self, message: object) -> None:
        """Send one message."""
        with self._lock:
            self._connection.send(message)
