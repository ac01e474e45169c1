"""The other end of the daemon's socket: what `portdock dock` and its siblings talk through."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from controller.daemon.protocol import Answer, Event, Request, message_of
from drivers.base import LinkOpenError

ANSWER_S = 10.0


class DaemonClient:
    """One connection to a daemon."""

    def __init__(self, path: Path) -> None:
        """Connect. Raises LinkOpenError when no daemon listens."""
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._line.settimeout(ANSWER_S)
        try:
            self._line.connect(str(path))
        except OSError as error:
            self._line.close()
            raise LinkOpenError(
                f"no daemon answers on {path} ({error.strerror or error})",
                remedy="Start one: `portdock run --config SITE`, or `portdock run --mock` to try it without hardware.",
            ) from error
        self._stream = self._line.makefile("rb")
        self._early: list[Event] = []

    def __enter__(self) -> DaemonClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.close()
        self._line.close()

    def ask(self, request: Request) -> Answer:
        """One request, one answer; events that come in between are kept. Raises LinkOpenError when the daemon goes."""
        try:
            self._line.settimeout(ANSWER_S)
            self._line.sendall(json.dumps({"request": request.value}).encode() + b"\n")
            while not isinstance(message := self._next(), Answer):
                self._early.append(message)
        except OSError as error:
            raise LinkOpenError(f"the daemon does not answer ({error})", remedy="See `portdock status`.") from error
        return message

    def events(self, timeout_s: float | None = None) -> Iterator[Event]:
        """Events as they happen, after ``subscribe``. Raises LinkOpenError when the daemon ends or is silent."""
        self._line.settimeout(timeout_s)
        while True:
            message = self._early.pop(0) if self._early else self._read()
            if not isinstance(message, Answer):
                yield message

    def _read(self) -> Answer | Event:
        try:
            return self._next()
        except OSError as error:
            raise LinkOpenError(f"the daemon is silent ({error})", remedy="See `portdock status`.") from error

    def _next(self) -> Answer | Event:
        line = self._stream.readline()
        if not line:
            raise LinkOpenError("the daemon has ended", remedy="See its log (`journalctl -u portdock`).")
        return message_of(line)
