"""One daemon a robot, and one a socket: a lock that the kernel gives up with the process, however that ends."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import ClassVar

from perception.errors import PortdockError


class RobotTakenError(PortdockError):
    """Another daemon drives this robot, or serves this socket."""

    code: ClassVar[str] = "robot-taken"
    default_remedy: ClassVar[str] = "Use that one (`portdock status`), or end it first."


class ProcessLock:
    """Held while inside. The file stays: only the lock on it counts."""

    def __init__(self, path: Path, what: str) -> None:
        """``what`` the lock stands for, as an error names it."""
        self._path = path
        self._what = what
        self._descriptor = -1

    def __enter__(self) -> ProcessLock:
        """Take the lock. Raises RobotTakenError, with the number of the process that has it."""
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            remedy = "Make the folder writable, or set service.state_folder."
            raise RobotTakenError(f"cannot write {self._path}: {error.strerror}", remedy=remedy) from error
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = self._path.read_text(encoding="utf-8", errors="replace").strip() or "unknown"
            os.close(self._descriptor)
            raise RobotTakenError(f"{self._what} belongs to process {holder} already") from error
        os.truncate(self._descriptor, 0)
        os.write(self._descriptor, f"{os.getpid()}\n".encode())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._descriptor)
