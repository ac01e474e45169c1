"""The LAWICEL ("slcan") line protocol as an adapter speaks it: lines in, answers and frames out. Pure, no descriptor.

Written from the protocol's public description. Not simulated: acceptance filters (accepted, without effect), time
stamps (refused), bit-timing registers (accepted, taken to be the bus's own bit rate).
"""

from __future__ import annotations

import string

from mocks.charger.frames import BusFrame

OK, BELL = b"\r", b"\a"
BIT_RATES = dict(
    zip("012345678", (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000), strict=True)
)
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_LONGEST_LINE = 160
_HEX = frozenset(string.hexdigits)


class Lawicel:
    """The adapter's side of one connection."""

    def __init__(self, bus_bit_rate: int) -> None:
        self._bus_bit_rate = bus_bit_rate
        self._bit_rate: int | None = None
        self._line = bytearray()
        self.is_open = False
        self.listen_only = False

    @property
    def on_bus(self) -> bool:
        """Open, and at the bus's bit rate: at another one nothing passes, whatever the host sees of it."""
        return self.is_open and self._bit_rate in (None, self._bus_bit_rate)

    def feed(self, data: bytes) -> tuple[bytes, list[BusFrame]]:
        """Bytes from the host: answers to it, and frames for the bus."""
        answers, frames = bytearray(), []
        for byte in data:
            if byte != 0x0D:
                self._line.append(byte)
                del self._line[:-_LONGEST_LINE]
                continue
            line, self._line = bytes(self._line), bytearray()
            answer, frame = self._obey(line.decode("latin-1"))
            answers += answer
            if frame is not None and self.on_bus:
                frames.append(frame)
        return bytes(answers), frames

    def tell(self, frame: BusFrame) -> bytes:
        """The line that hands a frame from the bus to the host; empty while the channel is closed."""
        if not self.on_bus:
            return b""
        kind = "r" if frame.remote else "d" if frame.fd else "t"
        head = f"{kind.upper()}{frame.identifier:08X}" if frame.extended else f"{kind}{frame.identifier:03X}"
        length = FD_LENGTHS.index(len(frame.data))
        body = "" if frame.remote else frame.data.hex().upper()
        return f"{head}{length:X}{body}\r".encode()

    def _obey(self, line: str) -> tuple[bytes, BusFrame | None]:
        if not line:
            return b"", None
        letter = line[0]
        if letter in "tTrRdDbB":
            return self._transmit(line)
        answer = self._settings(letter, line[1:])
        return (BELL if answer is None else answer), None

    def _settings(self, letter: str, rest: str) -> bytes | None:
        """The answer, or None for a refusal."""
        match letter:
            case "S" if not self.is_open and rest in BIT_RATES:
                self._bit_rate = BIT_RATES[rest]
                return OK
            case "s" | "Y" if not self.is_open:
                return OK
            case "O" | "L" if not self.is_open:
                self.is_open, self.listen_only = True, letter == "L"
                return OK
            case "C" if self.is_open:
                self.is_open = False
                return OK
            case "V":
                return b"V1013\r"
            case "N":
                return b"NA123\r"
            case "F" if self.is_open:
                return b"F00\r" if self.on_bus else b"F80\r"  # bit 7: bus error
            case "M" | "m":
                return OK
            case "Z" if rest == "0":
                return OK
        return None

    def _transmit(self, line: str) -> tuple[bytes, BusFrame | None]:
        extended = line[0].isupper()
        digits = 8 if extended else 3
        head, data = line[1 : 2 + digits], line[2 + digits :]
        fd, remote = line[0] in "dDbB", line[0] in "rR"
        if not self.is_open or self.listen_only or len(head) != digits + 1 or not _HEX.issuperset(head + data):
            return BELL, None
        code = int(head[-1], 16)
        if code > 8 and not fd:
            return BELL, None
        if len(data) != (0 if remote else 2 * FD_LENGTHS[code]):
            return BELL, None
        frame = BusFrame(int(head[:-1], 16), bytes.fromhex(data), extended, remote, fd)
        return (b"Z\r" if extended else b"z\r"), frame
