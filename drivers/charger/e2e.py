"""End-to-end protection: a counter and a checksum inside each frame, so that a stale or damaged frame is not believed.

Pure functions and one small class for each received message. The schemes, after wires.md A2's choice for the contract:
``none``, ``counter`` (no checksum), ``j1850`` (CRC-8 0x1D, start and final XOR 0xFF), ``e2e-p11`` (the same polynomial
with start and XOR 0, in the style of AUTOSAR E2E Profile 11, data id mode "both") and ``e2e-p5`` (CRC-16 0x1021, start
0xFFFF, in the style of Profile 5, for CAN FD). No claim of AUTOSAR conformity is made: the byte order of the data id is
taken from public implementations, not from the standard.
"""

from __future__ import annotations

import enum
from collections import deque
from dataclasses import dataclass, field


class Scheme(enum.StrEnum):
    """What protects the frames of a link."""

    NONE = "none"
    COUNTER = "counter"
    J1850 = "j1850"
    P11 = "e2e-p11"
    P5 = "e2e-p5"

    @property
    def crc_bytes(self) -> int:
        """How many bytes of the frame the checksum takes."""
        return {Scheme.J1850: 1, Scheme.P11: 1, Scheme.P5: 2}.get(self, 0)

    @property
    def counter_modulus(self) -> int:
        """How many values the counter runs through: 0 to 14 in four bits (15 is invalid), or all of a byte."""
        return 256 if self is Scheme.P5 else 15


class Verdict(enum.Enum):
    """What became of one received frame."""

    OK = "ok"
    LOST = "lost"
    """Accepted, but more than one frame before it is missing."""
    INITIAL = "initial"
    """The first one: nothing says yet that its counter moves."""
    REPEATED = "repeated"
    WRONG_SEQUENCE = "wrong_sequence"
    BAD_CRC = "bad_crc"

    @property
    def accepted(self) -> bool:
        """Whether the frame counts as received."""
        return self in (Verdict.OK, Verdict.LOST)


_RECENT, _RUN, _MIXED = 16, 5, 6
"""Of so many last frames this many in a row, or that many astray, are a pattern and not noise."""
MAX_DELTA = 2
"""A counter may move by this much (one missing frame) without a word."""


def _table(polynomial: int, width: int) -> tuple[int, ...]:
    top, mask = 1 << (width - 1), (1 << width) - 1
    table = []
    for byte in range(256):
        value = byte << (width - 8)
        for _ in range(8):
            value = ((value << 1) ^ polynomial if value & top else value << 1) & mask
        table.append(value)
    return tuple(table)


_CRC8_1D = _table(0x1D, 8)
_CRC16_1021 = _table(0x1021, 16)


def crc8(data: bytes, start: int, final_xor: int) -> int:
    """CRC-8 with polynomial 0x1D, most significant bit first (SAE J1850 with start and final XOR 0xFF)."""
    value = start
    for byte in data:
        value = _CRC8_1D[value ^ byte]
    return value ^ final_xor


def crc16(data: bytes, start: int = 0xFFFF) -> int:
    """CRC-16 with polynomial 0x1021, most significant bit first, no final XOR ("CCITT-FALSE")."""
    value = start
    for byte in data:
        value = ((value << 8) & 0xFFFF) ^ _CRC16_1021[(value >> 8) ^ byte]
    return value


@dataclass(frozen=True, slots=True)
class FrameProtection:
    """How one message is protected: scheme, its 16-bit data id, and where in the frame the checksum stands."""

    scheme: Scheme
    data_id: int
    crc_offset: int = 0
    """First byte of the checksum; two bytes are least significant first."""

    def checksum(self, frame: bytes) -> bytes:
        """The checksum of a frame, over the data id and all bytes but the checksum's own; empty without one."""
        size = self.scheme.crc_bytes
        payload = frame[: self.crc_offset] + frame[self.crc_offset + size :]
        identity = self.data_id.to_bytes(2, "little")
        if self.scheme is Scheme.J1850:
            return bytes((crc8(identity + payload, start=0xFF, final_xor=0xFF),))
        if self.scheme is Scheme.P11:
            return bytes((crc8(identity + payload, start=0, final_xor=0),))
        if self.scheme is Scheme.P5:
            return crc16(payload + identity).to_bytes(2, "little")
        return b""

    def seal(self, frame: bytes) -> bytes:
        """The frame with its checksum put in."""
        end = self.crc_offset + self.scheme.crc_bytes
        return frame[: self.crc_offset] + self.checksum(frame) + frame[end:]

    def intact(self, frame: bytes) -> bool:
        """Whether the frame carries its own checksum."""
        end = self.crc_offset + self.scheme.crc_bytes
        return frame[self.crc_offset : end] == self.checksum(frame)


def next_counter(counter: int, modulus: int) -> int:
    """The counter of the next frame."""
    return (counter + 1) % modulus


def classify(previous: int | None, counter: int, modulus: int) -> Verdict:
    """Judge a counter against the one before.

    A step of up to half the range counts as frames lost, a larger one as a step backwards: an old frame or a second
    sender.
    """
    if counter >= modulus:
        return Verdict.WRONG_SEQUENCE
    if previous is None:
        return Verdict.INITIAL
    delta = (counter - previous) % modulus
    if delta == 0:
        return Verdict.REPEATED
    if delta <= MAX_DELTA:
        return Verdict.OK
    return Verdict.LOST if delta <= modulus // 2 else Verdict.WRONG_SEQUENCE


@dataclass(slots=True)
class Receiver:
    """Remembers one message's last counter and counts what came of its frames."""

    protection: FrameProtection
    previous: int | None = None
    counts: dict[Verdict, int] = field(default_factory=lambda: dict.fromkeys(Verdict, 0))
    missed: int = 0
    """Frames that the counter says were sent and that never came."""
    recent: deque[Verdict] = field(default_factory=lambda: deque(maxlen=_RECENT))

    def check(self, frame: bytes, counter: int) -> Verdict:
        """Judge one frame whose counter field reads ``counter``, and remember it."""
        verdict = self._judge(frame, counter)
        self.counts[verdict] += 1
        self.recent.append(verdict)
        return verdict

    @property
    def suspicion(self) -> str:
        """What the last frames point to, when they do not run on as one sender's do; empty otherwise."""
        last = list(self.recent)[-_RUN:]
        if len(last) == _RUN and set(last) == {Verdict.REPEATED}:
            return "it repeats its last frame"
        if len(last) == _RUN and set(last) == {Verdict.BAD_CRC}:
            return "its checksums do not fit"
        astray = sum(v in (Verdict.REPEATED, Verdict.WRONG_SEQUENCE, Verdict.LOST) for v in self.recent)
        if astray >= _MIXED and len(self.recent) == _RECENT:
            return "counters jump: two nodes seem to send under its identifier"
        return ""

    @property
    def two_senders(self) -> bool:
        """Whether the last frames look like those of two nodes: neither can be believed."""
        return self.suspicion.startswith("counters jump")

    def forget(self) -> None:
        """After a silence the next frame is a first one again."""
        self.previous = None

    def _judge(self, frame: bytes, counter: int) -> Verdict:
        scheme = self.protection.scheme
        if scheme is Scheme.NONE:
            return Verdict.OK
        if not self.protection.intact(frame):
            return Verdict.BAD_CRC
        modulus = scheme.counter_modulus
        verdict = classify(self.previous, counter, modulus)
        if verdict.accepted and self.previous is not None:
            self.missed += (counter - self.previous) % modulus - 1
        if counter < modulus:
            self.previous = counter
        return verdict
