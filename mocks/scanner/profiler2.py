"""A SICK Profiler 2 at byte level: profile memory behind a half-duplex line, answers and errors after manual 8017035.

Commands: 400B profile address, 0002 read memory, A017 measured values. A packet with a wrong BCC, a wrong end or a
wrong parameter gets the device's own error; one that is not complete within 2 s is forgotten. The newest profile is
put into memory when its address is asked for. Not simulated: stored profiles (C00D, C010), settings, camera mode,
trigger input.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

from mocks.scanner.emulated_clock import EmulatedClock
from mocks.scanner.paced_wire import PacedWire
from mocks.scanner.sources import Source

if TYPE_CHECKING:  # SciPy behind it would double the time that a mock takes to come up
    from perception.geometry import Array

ADDRESS = 0x03062000
POINTS = 832
NO_MEASUREMENT = 0x7FFF
TURN_AROUND_S = 0.0015
GIVE_UP_S = 2.0
LOOK_BACK = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
"""Exposures before the newest one that are tried."""
UNKNOWN, PARAMETER, INCOMPLETE, CHECKSUM, FRAMING, COLLISION = 0xE001, 0xE002, 0xE003, 0xE004, 0xE005, 0xE007


def packet(command: int, data: bytes = b"") -> bytes:
    """A packet around whole data words."""
    body = struct.pack(">BH", len(data) // 2, command) + data
    check = 0
    for byte in body:
        check ^= byte
    return b"\x02" + body + b"\x03" + bytes([check])


def memory_image(line: Array, time_s: float, reference_m: float) -> bytes:
    """Header (size, time in 0.1 ms) and XY pairs in micrometres, as they lie in the device's memory."""
    x, y = np.zeros(POINTS), np.full(POINTS, np.nan)
    count = min(POINTS, len(line))
    x[:count], y[:count] = line[:count, 0] * 1e6, (reference_m - line[:count, 1]) * 1e6
    seen = np.isfinite(x) & np.isfinite(y) & (np.abs(np.nan_to_num(x)) < 32700) & (np.abs(np.nan_to_num(y)) < 32700)
    pairs = np.full((POINTS, 2), NO_MEASUREMENT, ">i2")
    pairs[seen] = np.round(np.stack([x, y], axis=1)[seen]).astype(np.int64)
    return struct.pack(">HH", POINTS * 32, round(time_s * 1e4) & 0xFFFF) + pairs.tobytes()


class Profiler2Device:
    """Answers questions; measures ``rate_hz`` times a second and remembers the newest profile only."""

    def __init__(
        self,
        source: Source,
        wire: PacedWire,
        clock: EmulatedClock,
        *,
        rate_hz: float = 200.0,
        reference_m: float = 0.10,
        address_in_words: bool = False,
    ) -> None:
        self._source = source
        self._wire = wire
        self._clock = clock
        self._rate_hz = rate_hz
        self._reference_m = reference_m
        self._unit_bytes = 2 if address_in_words else 1
        self._image = memory_image(np.empty((0, 2)), 0.0, reference_m)
        self._heard = b""
        self._heard_since_s = 0.0
        self._begun = False
        self._number = -1

    def receive(self, data: bytes) -> None:
        """Bytes from the client."""
        now_s = self._clock.now_s()
        if not self._heard:
            self._heard_since_s = now_s
        if not self._wire.idle:
            self._reply(packet(COLLISION))
            self._heard = b""
            return
        self._heard += data
        while self._heard:
            start = self._heard.find(b"\x02")
            if start < 0:
                self._heard = b""
                return
            self._heard = self._heard[start:]
            if len(self._heard) < 2 or len(self._heard) < (size := 6 + 2 * self._heard[1]):
                return
            request, self._heard = self._heard[:size], self._heard[size:]
            self._reply(self._answer(request))

    def collect(self) -> None:
        """Forget a question that does not come to its end."""
        if self._heard and self._clock.now_s() - self._heard_since_s > GIVE_UP_S:
            self._heard = b""
            self._reply(packet(INCOMPLETE))

    def stop(self) -> None:
        """Nothing runs by itself."""

    def _reply(self, data: bytes) -> None:
        self._wire.send(data, self._clock.now_s() + TURN_AROUND_S)

    def _answer(self, request: bytes) -> bytes:
        check = 0
        for byte in request[1:-2]:
            check ^= byte
        if request[-2] != 0x03:
            return packet(FRAMING)
        if check != request[-1]:
            return packet(CHECKSUM)
        command, data = int.from_bytes(request[2:4], "big"), request[4:-2]
        if command == 0x400B and not data:
            self._measure()
            return packet(0x400B, struct.pack(">I", ADDRESS))
        if command == 0x0002 and len(data) == 6:
            return self._read(*struct.unpack(">IBB", data), echo=data[:4])
        if command == 0xA017 and len(data) == 2:
            return packet(0xA017, data + struct.pack(">i", 0x7FFFFFFF))
        return packet(PARAMETER if command in (0x400B, 0x0002, 0xA017) else UNKNOWN)

    def _read(self, address: int, count: int, how: int, *, echo: bytes) -> bytes:
        """``how``: high digit 1 words or 2 pairs, low digit the step."""
        width, step = 2 * (how >> 4), how & 0x0F
        offset = (address - ADDRESS) * self._unit_bytes
        last = offset + ((count - 1) * step + 1) * width
        if how >> 4 not in (1, 2) or not step or not count or offset < 0 or last > len(self._image):
            return packet(PARAMETER)
        if 2 + count * width // 2 > 255:
            return packet(PARAMETER)
        items = [self._image[offset + k * step * width : offset + (k * step + 1) * width] for k in range(count)]
        return packet(0x0002, echo + b"".join(items))

    def _measure(self) -> None:
        """Put the newest exposure into memory of which the arm's pose is known; a busy computer knows it late."""
        if not self._begun:
            self._source.begin_sweep()
            self._begun = True
        newest = int(self._clock.now_s() * self._rate_hz)
        for back in LOOK_BACK:
            number = newest - back
            if number < 0 or number <= self._number:
                return
            lines = self._source.lines(number, [number / self._rate_hz])
            if lines:
                self._number = number
                self._image = memory_image(lines[0], number / self._rate_hz, self._reference_m)
                return
