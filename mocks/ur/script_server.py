"""Script ports (30003, and the script side of 30001 and 30002): URScript text in, programs started."""

from __future__ import annotations

import logging
import re

from mocks.ur.controller import Controller
from mocks.ur.sockets import Connection

log = logging.getLogger(__name__)

MAX_SCRIPT_BYTES = 1_000_000
_OPENS = re.compile(r"^(def|sec)\s+\w+\s*\(")


class ScriptClient:
    """The server's side of one connection. A script ends with ``end`` in the first column, a bare line with itself."""

    def __init__(self, connection: Connection, controller: Controller) -> None:
        self.controller = controller
        self._buffer = b""
        self._lines: list[str] = []

    def received(self, data: bytes) -> None:
        """Bytes from the client, in whatever pieces."""
        self._buffer += data
        if len(self._buffer) + sum(len(line) for line in self._lines) > MAX_SCRIPT_BYTES:
            log.warning("script longer than %d bytes forgotten", MAX_SCRIPT_BYTES)
            self._buffer, self._lines = b"", []
        while b"\n" in self._buffer:
            raw, self._buffer = self._buffer.split(b"\n", 1)
            self._line(raw.decode("utf-8", "replace").rstrip("\r"))

    def closed(self) -> None:
        """A half-sent script is forgotten."""

    def _line(self, line: str) -> None:
        if self._lines:
            self._lines.append(line)
            if line.rstrip() == "end":
                text, self._lines = "\n".join(self._lines), []
                self.controller.run_script(text)
        elif _OPENS.match(line):
            self._lines = [line]
        elif line.strip() and not line.lstrip().startswith("#"):
            self.controller.run_script(line)
