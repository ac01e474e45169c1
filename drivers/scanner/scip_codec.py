"""SCIP 2.0 and 2.2, the protocol of Hokuyo's URG family: text lines with a sum, numbers of six bits a character.

A reply is: the command's echo, a status of two characters with its sum, data lines each with its sum, an empty line.
The sum is the low six bits of the characters' sum, plus 0x30. Numbers take 2, 3 or 4 characters, most significant
first; a block of them is cut into lines of 64 characters, wherever that falls. Source: Hokuyo, "Communication
protocol specification for SCIP 2.0 standard", C-42-03320B.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]

LINE_CHARACTERS = 64
MAX_REPLY_BYTES = 1 << 16
OK, STREAMING = "00", "99"
_PRINTABLE_AND_NEW_LINE = bytes(range(0x20, 0x7F)) + b"\n"


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply: echo without line end, status, data lines without their sums."""

    echo: str
    status: str
    lines: tuple[bytes, ...] = ()


@dataclass
class ReplyCounters:
    """What the reader met."""

    bytes: int = 0
    replies: int = 0
    bytes_dropped: int = 0
    bad_checksum: int = 0

    def as_pairs(self) -> tuple[tuple[str, int], ...]:
        """(name, count) of each."""
        return tuple((item.name, getattr(self, item.name)) for item in fields(self))


@dataclass
class ReplyReader:
    """Bytes in any pieces -> replies. What has a wrong sum or no echo is dropped up to the next empty line."""

    counters: ReplyCounters = field(default_factory=ReplyCounters)
    _rest: bytes = b""

    def feed(self, data: bytes) -> list[Reply]:
        """Replies completed by ``data``. Never raises, whatever the bytes."""
        self.counters.bytes += len(data)
        *blocks, self._rest = (self._rest + data).split(b"\n\n")
        if len(self._rest) > MAX_REPLY_BYTES:
            self.counters.bytes_dropped += len(self._rest)
            self._rest = b""
        replies = []
        for block in blocks:
            if not block.strip(b"\n"):
                continue
            reply = parse_reply(block.lstrip(b"\n"))
            if reply is None:
                self.counters.bytes_dropped += len(block) + 2
                self.counters.bad_checksum += 1
            else:
                self.counters.replies += 1
                replies.append(reply)
        return replies

    def flush(self) -> None:
        """Forget an unfinished reply."""
        self.counters.bytes_dropped += len(self._rest)
        self._rest = b""


def parse_reply(block: bytes) -> Reply | None:
    """A reply's lines, checked; None if it is not a whole and sound one."""
    lines = block.split(b"\n")
    if len(lines) < 2 or len(lines[0]) < 2 or not lines[0].isascii() or not lines[0][:2].isalpha():
        return None
    if len(lines[1]) != 3:
        return None
    full = len(lines) - 3 - (len(lines[-1]) != LINE_CHARACTERS + 1)  # of measured data only the last line is shorter
    if full < 1 or not _are_sound(b"\n".join(lines[3 : 3 + full]), full):
        full = 0
    if not all(is_sound(line) for line in lines[1:3] + lines[3 + full :]):
        return None
    data = tuple(line[:-1] for line in lines[2:])
    return Reply(lines[0].decode("ascii"), lines[1][:2].decode("ascii"), data)


def _are_sound(text: bytes, count: int) -> bool:
    """``is_sound`` of full lines in one go, for those without a semicolon's freedom: the lines of measured data."""
    if len(text) != count * (LINE_CHARACTERS + 2) - 1 or text.translate(None, _PRINTABLE_AND_NEW_LINE):
        return False
    if text.count(b"\n") != count - 1:
        return False
    grid = np.frombuffer(text + b"\n", np.uint8).reshape(count, LINE_CHARACTERS + 2)
    if (grid[:, LINE_CHARACTERS + 1] != ord("\n")).any():
        return False
    sums = (grid[:, :LINE_CHARACTERS].sum(axis=1, dtype=np.uint8) & 0x3F) + 0x30  # wraps at 256: the low bits stay
    return bool((sums == grid[:, LINE_CHARACTERS]).all())


def line_sum(content: bytes) -> int:
    """The character that ends a line."""
    return (sum(content) & 0x3F) + 0x30


def is_sound(line: bytes) -> bool:
    """Whether a line ends with its sum. Sensors differ in whether a parameter's ``;`` belongs to it."""
    if len(line) < 2 or min(line) < 0x20 or max(line) > 0x7E:
        return False
    content, given = line[:-1], line[-1]
    return given == line_sum(content) or (content.endswith(b";") and given == line_sum(content[:-1]))


def decode(lines: tuple[bytes, ...], characters: int) -> Ints | None:
    """Numbers (N,) of ``characters`` characters each from a block's lines; None where the lines do not hold such."""
    raw = np.frombuffer(b"".join(lines), np.uint8) - np.uint8(0x30)
    if len(raw) % characters or (len(raw) and raw.max() > 0x3F):
        return None
    digits = raw.reshape(-1, characters).T.astype(np.int32, order="C")  # in rows: a few times faster
    values: Ints = digits[0]
    for place in range(1, characters):
        values <<= 6
        values |= digits[place]
    return values


def decode_one(text: bytes, characters: int) -> int | None:
    """The one number that ``text`` holds; None where it holds something else."""
    if len(text) != characters or not all(0x30 <= character <= 0x6F for character in text):
        return None
    value = 0
    for character in text:
        value = value << 6 | character - 0x30
    return value


def parameters(reply: Reply) -> tuple[tuple[str, str], ...]:
    """(key, value) of each line of a VV, PP or II reply."""
    pairs = (line.decode("ascii").rstrip(";").partition(":") for line in reply.lines)
    return tuple((key, value) for key, colon, value in pairs if colon)
