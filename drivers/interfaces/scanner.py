"""What a laser profiler offers to the controller."""

from __future__ import annotations

from typing import Protocol

from drivers.interfaces.link import LinkHealth
from perception.scan import Profile


class Scanner(Protocol):
    """A laser profiler."""

    def open(self) -> None:
        """Open the link and start its reader thread. Raises LinkOpenError."""

    def close(self) -> None:
        """Laser off, link closed. Idempotent."""

    def start(self) -> None:
        """Laser on, profiles flow. Raises LinkLostError."""

    def stop(self) -> None:
        """Laser off. Idempotent."""

    def take(self) -> list[Profile]:
        """Profiles decoded since the last call, oldest first; never blocks. Raises LinkLostError once it is lost."""

    def health(self) -> LinkHealth: ...
