"""Packets of the SICK Profiler 2: ``02 | LEN | command (2) | data words (2 LEN, big-endian) | 03 | BCC``.

LEN counts the data words; BCC is the XOR of all bytes strictly between 02 and 03. There is no byte stuffing: 02 and
03 occur in data, so a packet is framed by LEN. Source: SICK manual 8017035, whose printed examples contain misprints:
a size reply with two words but the LEN and BCC of one, a profile reply with LEN FF where FE follows, three wrong
BCCs. A ``tolerant`` reader therefore accepts a packet whose end stands one word off LEN or whose BCC is wrong, and
counts it; a strict one, the default, drops it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

STX, ETX = 0x02, 0x03
OVERHEAD = 6
"""STX, LEN, command (2), ETX, BCC."""
MAX_POINTS_PER_READ = 126

GET_PROFILE_ADDRESS = 0x400B
READ_MEMORY = 0x0002
MEASURED_VALUES = 0xA017

ERRORS = {
    0xE001: "unknown command",
    0xE002: "wrong parameter",
    0xE003: "packet incomplete or too late",
    0xE004: "checksum error",
    0xE005: "framing error",
    0xE006: "flash memory error",
    0xE007: "collision on the line",
    0xE008: "not possible while measuring",
}
TRANSMISSION_ERRORS = (0xE003, 0xE004, 0xE005, 0xE007)
"""The device did not understand what arrived: asking again is right."""

Words = NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """One packet from the device."""

    command: int
    words: Words


def encode(command: int, words: Sequence[int] = ()) -> bytes:
    """A packet as bytes. ``words`` are 0 to 65535."""
    body = bytes([len(words)]) + command.to_bytes(2, "big") + b"".join(word.to_bytes(2, "big") for word in words)
    return bytes([STX]) + body + bytes([ETX, block_check(body)])


def read_request(address: int, count: int, *, pairs: bool = False, step: int = 1) -> bytes:
    """Ask for ``count`` words, or XY pairs, from ``address`` on; ``step`` 2 to 15 takes each step-th only."""
    return encode(READ_MEMORY, (address >> 16, address & 0xFFFF, count << 8 | (2 if pairs else 1) << 4 | step))


def block_check(body: bytes) -> int:
    """XOR of all bytes."""
    return int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8))) if body else 0


@dataclass
class PacketCounters:
    """What the reader met."""

    bytes: int = 0
    packets: int = 0
    bytes_dropped: int = 0
    bad_checksum: int = 0
    tolerated: int = 0

    def as_pairs(self) -> tuple[tuple[str, int], ...]:
        """(name, count) of each."""
        return tuple((item.name, getattr(self, item.name)) for item in fields(self))


@dataclass
class PacketReader:
    """Bytes in any pieces -> packets. Goes on one byte later wherever a packet does not fit."""

    tolerant: bool = False
    counters: PacketCounters = field(default_factory=PacketCounters)
    _rest: bytes = b""

    def feed(self, data: bytes) -> list[Packet]:
        """Packets completed by ``data``. Never raises, whatever the bytes."""
        self.counters.bytes += len(data)
        buffer, position, packets = self._rest + data, 0, list[Packet]()
        while position < len(buffer):
            size = self._fits(buffer, position)
            if size is None:
                break
            if size == 0:
                following = buffer.find(STX, position + 1)
                following = len(buffer) if following < 0 else following
                self.counters.bytes_dropped += following - position
                position = following
                continue
            words = np.frombuffer(buffer, ">u2", (size - OVERHEAD) // 2, position + 4).astype(np.uint16)
            packets.append(Packet(int.from_bytes(buffer[position + 2 : position + 4], "big"), words))
            self.counters.packets += 1
            position += size
        self._rest = buffer[position:]
        return packets

    def flush(self) -> None:
        """Forget an unfinished packet."""
        self.counters.bytes_dropped += len(self._rest)
        self._rest = b""

    def _fits(self, buffer: bytes, position: int) -> int | None:
        """Bytes of the packet that starts here, 0 if none does, None if that needs more bytes."""
        if buffer[position] != STX:
            return 0
        if len(buffer) < position + 2:
            return None
        nominal = OVERHEAD + 2 * buffer[position + 1]
        sizes = (nominal, nominal - 2, nominal + 2) if self.tolerant else (nominal,)
        waiting = False
        for size in sizes:
            if size < OVERHEAD:
                continue
            if len(buffer) < position + size:
                waiting = True
                continue
            ended = buffer[position + size - 2] == ETX
            checked = block_check(buffer[position + 1 : position + size - 2]) == buffer[position + size - 1]
            if ended and (checked or (self.tolerant and size == nominal)):
                self.counters.tolerated += size != nominal or not checked
                return size
            self.counters.bad_checksum += ended and size == nominal
        return None if waiting else 0
