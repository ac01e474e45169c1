"""A recorded scanner, byte for byte: what the device said on a mission is said again, when the client asks the same.

The recording is portdock's MCAP: topics ``/scanner/rx`` and ``/scanner/tx``, each message the host's monotonic time
in nanoseconds (protobuf field 1, fixed64) and the bytes (field 2) exactly as one read or write moved them. What was
received is sent with the recorded gaps, at the client's baud rate at most. What was sent is waited for: the client
must send the same bytes; where it does not, the replay ends and says what differed. Read here anew, sharing no code
with the recorder. Not simulated: a device that reacts to anything but the recorded conversation.
"""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from mocks.scanner.emulated_clock import EmulatedClock
from mocks.scanner.paced_wire import PacedWire

logger = logging.getLogger(__name__)

TOPICS: dict[str, Literal["rx", "tx"]] = {"/scanner/rx": "rx", "/scanner/tx": "tx"}


@dataclass(frozen=True, slots=True)
class Spoken:
    """Bytes of one direction, seen from the host: ``rx`` came from the device."""

    time_s: float
    side: Literal["rx", "tx"]
    data: bytes


def read_conversation(path: Path) -> list[Spoken]:
    """Both directions in order of time. Raises ValueError for a file without a scanner's bytes."""
    spoken: list[Spoken] = []
    channels: dict[int, str] = {}
    with path.open("rb") as stream:
        for record in StreamReader(stream, record_size_limit=None).records:
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message) and (side := TOPICS.get(channels.get(record.channel_id, ""))):
                time_ns, data = _fields(record.data)
                spoken.append(Spoken(time_ns * 1e-9, side, data))
    if not any(part.side == "rx" for part in spoken):
        raise ValueError(f"{path} holds no bytes of a scanner")
    return sorted(spoken, key=lambda part: part.time_s)


class RecordedDevice:
    """Plays a conversation; ``mismatch`` says where the client left it."""

    def __init__(self, spoken: list[Spoken], wire: PacedWire, clock: EmulatedClock) -> None:
        self._left = deque(spoken)
        self._wire = wire
        self._clock = clock
        self._shift_s: float | None = None
        """Emulated time less recorded time."""
        self._heard = b""
        self.mismatch = ""

    def receive(self, data: bytes) -> None:
        """Bytes from the client: those that the recording says come now, or the replay is over."""
        if self.mismatch:
            return
        self._heard += data
        self._release()
        while self._heard and self._left and self._left[0].side == "tx":
            due = self._left[0]
            if len(self._heard) < len(due.data) and due.data.startswith(self._heard):
                return
            if not self._heard.startswith(due.data):
                self._give_up(due.data)
                return
            self._heard = self._heard[len(due.data) :]
            self._left.popleft()
            self._shift_s = self._clock.now_s() - due.time_s
            self._release()
        if self._heard and not self._left:
            self._give_up(b"")

    def collect(self) -> None:
        """Nothing becomes ready by itself: what is due was handed to the wire with its time."""

    def stop(self) -> None:
        """Nothing runs by itself."""
        logger.info("replay ended with %d recorded pieces left%s", len(self._left), self.mismatch and ": mismatch")

    def _release(self) -> None:
        """Hand over what was received up to the next bytes that were sent."""
        if self._shift_s is None and self._left:
            self._shift_s = self._clock.now_s() - self._left[0].time_s
        while self._left and self._left[0].side == "rx":
            part = self._left.popleft()
            self._wire.send(part.data, part.time_s + (self._shift_s or 0.0))

    def _give_up(self, wanted: bytes) -> None:
        first = next((k for k, (a, b) in enumerate(zip(wanted, self._heard, strict=False)) if a != b), len(wanted))
        self.mismatch = (
            f"byte {first}: the recording has {wanted[first : first + 16].hex(' ') or 'no further question'},"
            f" the client sent {self._heard[first : first + 16].hex(' ')}"
        )
        self._left.clear()
        logger.error("replay mismatch at %s", self.mismatch)


def _fields(record: bytes) -> tuple[int, bytes]:
    """Time in ns and bytes of one protobuf record. Raises ValueError where it is none."""
    time_ns, data, position = 0, b"", 0
    while position < len(record):
        tag = record[position]
        position += 1
        if tag & 7 == 1:
            value = int.from_bytes(record[position : position + 8], "little")
            position += 8
        else:
            value, position = _varint(record, position)
        if tag & 7 == 2:
            data, position = record[position : position + value], position + value
        elif tag >> 3 == 1:
            time_ns = value
    return time_ns, data


def _varint(record: bytes, position: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte = record[position]
        value |= (byte & 0x7F) << shift
        position, shift = position + 1, shift + 7
        if not byte & 0x80:
            return value, position
