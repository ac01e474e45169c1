"""The device's transmitter: bytes leave one after another at the baud rate, in emulated time.

Bytes wait in the transmitter's own queue until their time has come, then in a buffer that stands for the client's
UART and kernel buffers; what does not fit there is lost, as when a real client does not read.
"""

from __future__ import annotations

from collections import deque

from mocks.scanner.pty_line import PtyLine
from mocks.scanner.wire_faults import WireFaults


class PacedWire:
    """Paces, spoils on request, and counts. All times are emulated seconds."""

    def __init__(self, line: PtyLine, faults: WireFaults, device_baud: int | None, buffer_bytes: int) -> None:
        self._line = line
        self._faults = faults
        self._device_baud = device_baud
        self._buffer_bytes = buffer_bytes
        self._pending: deque[tuple[float, bytes]] = deque()
        self._offset = 0
        self._began_s = 0.0
        self._buffer = b""
        self.sent_bytes = 0
        self.overrun_bytes = 0

    def send(self, data: bytes, not_before_s: float) -> None:
        """Queue ``data`` for the line; the first bit leaves no earlier than ``not_before_s``."""
        self._pending.append((not_before_s, data))

    def clear(self) -> None:
        """Forget what has not left yet."""
        self._pending.clear()
        self._offset = 0

    @property
    def idle(self) -> bool:
        """Nothing waits to be sent."""
        return not self._pending and not self._buffer

    def pump(self, now_s: float) -> float | None:
        """Put on the line what is due at ``now_s``. Returns the time at which more is due, or None."""
        baud = self._line.client_baud() if self._line.plugged_in else (self._device_baud or 115200)
        byte_s = 10.0 / (self._device_baud or max(baud, 1))
        wrong_baud = self._device_baud is not None and baud != self._device_baud
        due = None
        while self._pending:
            not_before, data = self._pending[0]
            if self._offset == 0:
                self._began_s = max(self._began_s, not_before)
            ready = int((now_s - self._began_s) / byte_s)
            if ready <= self._offset:
                due = self._began_s + (self._offset + 1) * byte_s
                break
            piece = data[self._offset : ready]
            self._deliver(self._faults.spoil(piece, now_s, wrong_baud))
            self._offset += len(piece)
            if self._offset == len(data):
                self._began_s += len(data) * byte_s
                self._offset = 0
                self._pending.popleft()
        self._drain()
        return due

    def _deliver(self, data: bytes) -> None:
        room = max(0, self._buffer_bytes - len(self._buffer))
        self.overrun_bytes += max(0, len(data) - room)
        self._buffer += data[:room]
        self._drain()

    def _drain(self) -> None:
        if self._buffer:
            written = self._line.write(self._buffer)
            self.sent_bytes += written
            self._buffer = self._buffer[written:]
