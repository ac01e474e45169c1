"""systemd's notification protocol (sd_notify(3)): one datagram a message to the socket that systemd names.

Without ``NOTIFY_SOCKET`` in the environment nothing is sent. The watchdog's sign of life comes from ``alive``, which
the supervisor's tick calls and nothing else: a daemon whose tick hangs is restarted by systemd.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping

from drivers.base import Clock


class Notifier:
    """Tells systemd how the service is."""

    def __init__(self, clock: Clock, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._clock = clock
        self._period_s = _watchdog_s(environment) / 4.0
        self._next_s = -float("inf")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)

    def ready(self, status: str) -> None:
        """The service serves."""
        self._send(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        """One line for ``systemctl status``."""
        self._send(f"STATUS={text}")

    def stopping(self, text: str) -> None:
        """The service is on its way out."""
        self._send(f"STOPPING=1\nSTATUS={text}")

    def alive(self) -> None:
        """A tick has passed: a sign of life when one is due, four in each period of the watchdog."""
        now_s = self._clock.now_s()
        if self._period_s > 0.0 and now_s >= self._next_s:
            self._next_s = now_s + self._period_s
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Nothing is sent any more."""
        self._socket.close()

    def _send(self, text: str) -> None:
        if self._address:
            with contextlib.suppress(OSError):  # systemd that does not listen must not stop the tick
                self._socket.sendto(text.encode(), self._address)


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """The watchdog's period in seconds; 0 when there is none, or when it is meant for another process."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return 0.0
    try:
        return int(environment.get("WATCHDOG_USEC", "0")) / 1e6
    except ValueError:
        return 0.0
