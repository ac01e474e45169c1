"""The device's transmitter: bytes leave one after another at the baud rate, in emulated time.

Bytes wait in the transmitter's own queue until their time has come, then in a buffer that stands for the client's
UART and kernel buffers; what does not fit there is lost, as when a real client does not read.
"""

from __future__ import annotations

from collections import deque

from mocks.scanner.pty_line import PtyLine
from mocks.scanner.wire_faults import WireFaults

FALLBACK_BAUD = 115200
PIECE_BYTES = 4096


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
        self._progress_s = 0.0
        self.sent_bytes = 0
        self.overrun_bytes = 0

    def send(self, data: bytes, not_before_s: float) -> None:
        """Queue ``data`` for the line; the first bit leaves no earlier than ``not_before_s``."""
        self._pending.append((not_before_s, data))

    @property
    def blocked(self) -> bool:
        """Bytes are due for which the client's buffer has no room."""
        return bool(self._buffer)

    @property
    def idle(self) -> bool:
        """Nothing waits to be sent."""
        return not self._pending and not self._buffer

    def _baud(self) -> int:
        return self._line.client_baud() if self._line.plugged_in else (self._device_baud or FALLBACK_BAUD)

    def backlog_s(self, now_s: float) -> float:
        """For how long from now the line is busy with what it was given."""
        if not self._pending:
            return 0.0
        waiting = sum(len(data) for _, data in self._pending)
        byte_s = 10.0 / (self._device_baud or max(self._baud(), 1))
        return max(self._began_s, self._pending[0][0]) + waiting * byte_s - now_s

    def pump(self, now_s: float) -> None:
        """Put on the line what is due at ``now_s``."""
        self._drain(now_s)
        baud = self._baud()
        byte_s = 10.0 / (self._device_baud or max(baud, 1))
        wrong_baud = self._device_baud is not None and baud != self._device_baud
        while self._pending:
            not_before_s, data = self._pending[0]
            if self._offset == 0:
                self._began_s = max(self._began_s, not_before_s)
            due = int((now_s - self._began_s) / byte_s)
            piece = data[self._offset : min(due, self._offset + self._room(now_s, byte_s))]
            if not piece:
                return
            self._deliver(self._faults.spoil(piece, now_s, wrong_baud), now_s)
            self._offset += len(piece)
            if self._offset == len(data):
                self._began_s += len(data) * byte_s
                self._offset = 0
                self._pending.popleft()

    def _room(self, now_s: float, byte_s: float) -> int:
        """Bytes that may leave now. A client that has not read for as long as the buffer lasts loses what comes.

        Until then a full buffer holds the line back: the fault may be this process, which was not given the processor.
        """
        room = self._buffer_bytes - len(self._buffer)
        stalled = now_s - self._progress_s > self._buffer_bytes * byte_s
        return PIECE_BYTES if stalled else min(room, PIECE_BYTES)

    def _deliver(self, data: bytes, now_s: float) -> None:
        room = max(0, self._buffer_bytes - len(self._buffer))
        self.overrun_bytes += max(0, len(data) - room)
        self._buffer += data[:room]
        self._drain(now_s)

    def _drain(self, now_s: float) -> None:
        written = self._line.write(self._buffer) if self._buffer else 0
        self.sent_bytes += written
        self._buffer = self._buffer[written:]
        if written or not self._buffer:
            self._progress_s = now_s
