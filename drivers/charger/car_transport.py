"""J1939-21 transport protocol, listening only: messages longer than 8 bytes put together from their packets.

Both ways of sending are followed: announced to all (BAM) and between two nodes (RTS, CTS, end of message). Nothing is
ever answered; a packet that is missing loses the message. Pure: time is passed in.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

CONNECTION_PF, DATA_PF = 0xEC, 0xEB
_RTS, _CTS, _END, _BAM, _ABORT = 16, 17, 19, 32, 255
_SILENCE_S = 1.25
"""A message whose next packet does not come within this is given up (T2 of the standard)."""
_LARGEST = 1785


@dataclass(frozen=True, slots=True)
class Identifier:
    """A 29-bit identifier taken apart."""

    pgn: int
    source: int
    destination: int
    """255 for all."""

    @staticmethod
    def of(identifier: int) -> Identifier:
        """PDU1 (below 0xF0) carries a destination in the byte that PDU2 has as the end of its PGN."""
        form, specific = identifier >> 16 & 0xFF, identifier >> 8 & 0xFF
        page = identifier >> 8 & 0x30000
        if form < 0xF0:
            return Identifier(page | form << 8, identifier & 0xFF, specific)
        return Identifier(page | form << 8 | specific, identifier & 0xFF, 0xFF)


@dataclass(slots=True)
class _Incoming:
    pgn: int
    size: int
    packets: int
    last_s: float
    data: bytearray = field(default_factory=bytearray)
    next_number: int = 1


class Transport:
    """Messages under way, one for each pair of nodes."""

    def __init__(self) -> None:
        self._open: dict[tuple[int, int], _Incoming] = {}
        self.counters: Counter[str] = Counter()

    def take(self, about: Identifier, data: bytes, now_s: float) -> tuple[int, bytes] | None:
        """One frame of the transport protocol: PGN and data of the message that it completes, else None."""
        pair = (about.source, about.destination)
        if len(data) != 8:
            self.counters["bad_packets"] += 1
            return None
        if about.pgn >> 8 == CONNECTION_PF:
            self._connection(pair, data, now_s)
            return None
        return self._packet(pair, data, now_s)

    def _connection(self, pair: tuple[int, int], data: bytes, now_s: float) -> None:
        control, pgn = data[0], int.from_bytes(data[5:8], "little")
        if control in (_RTS, _BAM):
            size, packets = int.from_bytes(data[1:3], "little"), data[3]
            if not 8 < size <= _LARGEST or packets != -(-size // 7):
                self.counters["bad_packets"] += 1
                return
            if pair in self._open:
                self.counters["broken_off"] += 1
            self._open[pair] = _Incoming(pgn, size, packets, now_s)
        elif control == _ABORT:  # either side may give up
            for way in (pair, pair[::-1]):
                if self._open.pop(way, None) is not None:
                    self.counters["broken_off"] += 1
        elif control == _CTS:
            self._resent(pair[::-1], data, now_s)

    def _resent(self, way: tuple[int, int], data: bytes, now_s: float) -> None:
        """The receiver says from which packet on it wants to be sent, earlier ones again if need be."""
        message, number = self._open.get(way), data[2]
        if message is None:
            return
        message.last_s = now_s
        if data[1] and 1 <= number < message.next_number:
            message.next_number = number
            del message.data[7 * (number - 1) :]

    def _packet(self, pair: tuple[int, int], data: bytes, now_s: float) -> tuple[int, bytes] | None:
        message = self._open.get(pair)
        if message is None:
            self.counters["stray_packets"] += 1
            return None
        if now_s - message.last_s > _SILENCE_S or data[0] != message.next_number:
            del self._open[pair]
            self.counters["broken_off"] += 1
            return None
        message.data += data[1:]
        message.next_number, message.last_s = message.next_number + 1, now_s
        if message.next_number <= message.packets:
            return None
        del self._open[pair]
        self.counters["messages"] += 1
        return message.pgn, bytes(message.data[: message.size])
