"""A SCIP 2.0/2.2 range finder at byte level, with the figures of a URG-04LX: 682 steps over 240 degrees, 10 Hz.

Commands: VV PP II, BM QT RS RT, SS, TM0 TM1 TM2, GD GS GE, MD MS ME, %ST of SCIP 2.2; others get status 0E. Written
from Hokuyo's specification C-42-03320B, sharing no code with the driver. What it sees is a view's
(``mocks.scanner.turning_views``): a made-up room, or the mock world. A scan's time stamp is that of its beginning. Not
simulated: multi-echo, motor speed (CR), reboot (RB), what wear and sunlight do to ranges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocks.scanner.emulated_clock import EmulatedClock
from mocks.scanner.paced_wire import PacedWire
from mocks.scanner.turning_views import RoomView, Scan, View

Ints = NDArray[np.int64]

VERSION = ("VEND:portdock", "PROD:mock range finder", "FIRM:1.0.0(mock)", "PROT:SCIP 2.0", "SERI:H0000001")
GEOMETRY = ("MODL:URG-04LX(mock)", "DMIN:20", "DMAX:5600", "ARES:1024", "AMIN:44", "AMAX:725", "AFRT:384", "SCAN:600")
FIRST, LAST, FRONT, STEPS = 44, 725, 384, 1024
SCAN_S = 0.1
BAUDS = (19200, 57600, 115200, 250000, 500000, 750000)


def with_sum(content: bytes) -> bytes:
    """A line: content, sum, line feed."""
    return content + bytes([(sum(content) & 0x3F) + 0x30]) + b"\n"


def encode(values: Ints, characters: int) -> bytes:
    """Numbers as characters of six bits, most significant first, in lines of 64 characters with their sums."""
    shifts = 6 * np.arange(characters - 1, -1, -1)
    text = (((np.asarray(values, np.int64)[:, None] >> shifts) & 0x3F) + 0x30).astype(np.uint8).tobytes()
    return b"".join(with_sum(text[start : start + 64]) for start in range(0, len(text), 64))


STEPS_SEEN = np.arange(FIRST, LAST + 1)
ANGLES_RAD = -2 * np.pi * (STEPS_SEEN - FRONT) / STEPS
"""Of each step, to the right of the front: steps count to the left."""
LATEST_SCANS = 20
"""So far back a scan may lie whose view is known late."""


class ScipDevice:
    """Answers commands and streams scans."""

    def __init__(
        self,
        wire: PacedWire,
        clock: EmulatedClock,
        view: View | None = None,
        *,
        clock_offset_s: float = 0.0,
        ppm: float = 0.0,
    ) -> None:
        self._view = view or RoomView(STEPS_SEEN, FRONT)
        self._wire = wire
        self._clock = clock
        self._clock_offset_s = clock_offset_s
        self._ppm = ppm
        self._rest = b""
        self._laser = False
        self._adjusting = False
        self._baud = 115200
        self._stream: bytes | None = None
        self._left = 0
        self._next_scan = 0

    def receive(self, data: bytes) -> None:
        """Bytes from the client; a command ends with LF or CR."""
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        self._rest = self._rest[-128:]
        for line in lines:
            if line:
                self._send(self._answer(line))

    def collect(self) -> None:
        """Send the newest scan that is due and whose view is known."""
        found = None if self._stream is None else self._newest(self._next_scan)
        if self._stream is None or found is None:
            return
        number, seen = found
        skip = int(self._stream[12:13])
        self._next_scan = number + 1 + skip
        if self._wire.backlog_s(self._clock.now_s()) > 2 * SCAN_S:
            return  # a line too slow for the rate: this scan is not sent
        endless = self._stream[13:15] == b"00"
        self._left -= 0 if endless else 1
        echo = self._stream[:13] + (b"00" if endless else b"%02d" % self._left) + self._stream[15:]
        self._send(echo + b"\n" + with_sum(b"99") + _lines(self._stream, seen, self._ticks(number * SCAN_S)) + b"\n")
        if not endless and self._left == 0:
            self._stream, self._laser = None, False

    def _newest(self, first: int) -> tuple[int, Scan] | None:
        """The newest scan from number ``first`` on of which it is known what it saw."""
        newest = int(self._clock.now_s() / SCAN_S)
        for number in range(newest, max(first, newest - LATEST_SCANS) - 1, -1):
            if (seen := self._view.scan(number, number * SCAN_S)) is not None:
                return number, seen
        return None

    def stop(self) -> None:
        """Nothing runs by itself."""

    def _send(self, data: bytes) -> None:
        self._wire.send(data, self._clock.now_s())

    def _answer(self, line: bytes) -> bytes:
        code, _, _ = line.partition(b";")
        if code == b"%ST":  # SCIP 2.2
            return line + b"\n" + with_sum(b"00") + with_sum(self._state_number()) + b"\n"
        status, body = self._obey(code[:2], code[2:], line)
        return line + b"\n" + with_sum(status) + body + b"\n"

    def _obey(self, code: bytes, arguments: bytes, line: bytes) -> tuple[bytes, bytes]:
        """Status and data lines."""
        texts = {b"VV": VERSION, b"PP": GEOMETRY, b"II": self._state()}
        if code in texts and not arguments:
            return b"00", b"".join(_parameter(text) for text in texts[code])
        if code in (b"GD", b"GS", b"GE"):
            return self._once(code, arguments)
        if code in (b"MD", b"MS", b"ME"):
            return self._begin(arguments, line), b""
        if code == b"TM" and arguments in (b"0", b"1", b"2"):
            return self._adjust(arguments)
        if code == b"SS" and len(arguments) == 6 and arguments.isdigit():
            return self._set_baud(int(arguments)), b""
        if arguments:
            return b"0E", b""
        if code == b"BM":
            status = b"02" if self._laser else b"00"
            self._laser = True
            return status, b""
        if code in (b"QT", b"RS", b"RT"):
            self._stream, self._laser, self._adjusting = None, False, False
            return b"00", b""
        return b"0E", b""

    def _state(self) -> tuple[str, ...]:
        laser = "ON" if self._laser else "OFF"
        measuring = "Measuring by sensitive mode" if self._stream else "Idle"
        time_text = f"{self._ticks(self._clock.now_s()):06X}"
        return (
            "MODL:URG-04LX(mock)",
            f"LASR:{laser}",
            "SCSP:Initial(600[rpm])",
            f"MESM:{measuring}",
            f"SBPS:{self._baud}[bps]",
            f"TIME:{time_text}",
            "STAT:Sensor works well.",
        )

    def _state_number(self) -> bytes:
        """Of SCIP 2.2: standby, adjusting the time, lit for single scans, streaming."""
        if self._stream is not None:
            return b"004"
        return b"003" if self._laser else (b"002" if self._adjusting else b"000")

    def _ticks(self, time_s: float) -> int:
        return round((self._clock_offset_s + time_s * (1.0 + self._ppm * 1e-6)) * 1e3) & 0xFFFFFF

    def _adjust(self, mode: bytes) -> tuple[bytes, bytes]:
        """TM0 enter, TM1 time, TM2 leave the adjust mode."""
        if mode == b"1":
            if not self._adjusting:
                return b"04", b""
            return b"00", encode(np.array([self._ticks(self._clock.now_s())]), 4)
        wanted = mode == b"0"
        if wanted == self._adjusting:
            return (b"02" if wanted else b"03"), b""
        self._adjusting = wanted
        return b"00", b""

    def _set_baud(self, baud: int) -> bytes:
        if baud not in BAUDS:
            return b"04"
        status = b"03" if baud == self._baud else b"00"
        self._baud = baud
        return status

    def _once(self, code: bytes, arguments: bytes) -> tuple[bytes, bytes]:
        error = _range_error(arguments, 10)
        if error:
            return error, b""
        if not self._laser:
            return b"10", b""
        if (found := self._newest(0)) is None:
            return b"50", b""  # the world has no arm yet
        number, seen = found
        return b"00", _lines(code + arguments, seen, self._ticks(number * SCAN_S))

    def _begin(self, arguments: bytes, line: bytes) -> bytes:
        error = _range_error(arguments, 13)
        if error:
            return error
        if not arguments[10:11].isdigit():
            return b"06"
        if not arguments[11:13].isdigit():
            return b"07"
        self._laser = True
        self._stream, self._left = line, int(arguments[11:13])
        self._next_scan = int(self._clock.now_s() / SCAN_S) + 1
        return b"00"


def _lines(command: bytes, seen: Scan, ticks: int) -> bytes:
    """Time stamp and data lines of a scan as ``command`` wants them."""
    first, last, cluster = int(command[2:6]), int(command[6:10]), max(1, int(command[10:12]))
    ranges, light = seen
    starts = np.arange(first, last + 1, cluster) - FIRST
    ends = last - FIRST + 1
    least = np.array([ranges[start : min(start + cluster, ends)].min() for start in starts])
    stamp = encode(np.array([ticks]), 4)
    if command[1:2] == b"E":
        return stamp + encode(np.stack([least, light[starts]], axis=1).ravel(), 3)
    if command[1:2] == b"S":
        return stamp + encode(np.minimum(least, 4095), 2)
    return stamp + encode(least, 3)


def _parameter(text: str) -> bytes:
    """``KEY:value;`` and the sum of what stands before the semicolon."""
    content = text.encode("ascii")
    return content + b";" + with_sum(content)[-2:]


def _range_error(arguments: bytes, length: int) -> bytes:
    """Status for first step, last step and cluster; empty if they are right."""
    if len(arguments) != length:
        return b"0C"
    for status, part in ((b"01", arguments[:4]), (b"02", arguments[4:8]), (b"03", arguments[8:10])):
        if not part.isdigit():
            return status
    first, last = int(arguments[:4]), int(arguments[4:8])
    if last > LAST or first < FIRST:
        return b"04"
    return b"05" if last < first else b""
