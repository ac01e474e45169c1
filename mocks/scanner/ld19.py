"""An LDROBOT LD06 or LD19 at byte level: it turns and streams as soon as it has power, and hears nothing.

A packet is 47 bytes, little-endian: 54 2C, speed (degrees per second), start angle (0.01 degree), twelve times range
(mm) and intensity, end angle, time (ms, modulo 30,000), CRC-8 with polynomial 0x4D over all before it. Written from
the maker's manual, sharing no code with the driver. It sees a round room that it makes up, with a dent, or the mock
world from where the arm truly was. Not simulated: motor speed control, its spread, what sunlight does.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mocks.scanner.emulated_clock import EmulatedClock
from mocks.scanner.paced_wire import PacedWire

POINTS = 12
RATE_HZ = 375.0
SPEED_DEG_S = 3600
STEP_DEG = SPEED_DEG_S / RATE_HZ / POINTS
MAX_BACKLOG_S = 0.2
MAX_LAG_S = 2.0
"""So long a packet waits until it is known what was seen; then it is skipped."""

Ranges = NDArray[np.int64]
Sight = Callable[[Sequence[float], float], Ranges | None]
"""Ranges in mm (0: no echo) at angles in degrees to the right of the front, at a time; None while it is not known."""


def crc8(data: bytes) -> int:
    """Polynomial 0x4D, initial value 0, most significant bit first."""
    register = 0
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1 ^ 0x4D if register & 0x80 else register << 1) & 0xFF
    return register


def room_mm(angle_deg: float) -> int:
    """Range of the made-up room: 2 m, at 90 degrees half a metre less."""
    return round(2000 - 500 * math.exp(-(((angle_deg - 90.0) / 10.0) ** 2)))


def room(angles_deg: Sequence[float], time_s: float) -> Ranges:
    """``Sight`` of the made-up room, which never changes."""
    return np.array([room_mm(angle) for angle in angles_deg])


def angles_of(number: int) -> list[float]:
    """Degrees of a packet's points."""
    first = number * POINTS * STEP_DEG
    return [(first + k * STEP_DEG) % 360.0 for k in range(POINTS)]


def packet(number: int, time_s: float, ranges_mm: Sequence[int] | Ranges | None = None) -> bytes:
    """Packet ``number`` since power-on, measured at the device's time; without ranges, of the made-up room."""
    angles = angles_of(number)
    ranges = room(angles, time_s) if ranges_mm is None else ranges_mm
    body = struct.pack("<BBHH", 0x54, 0x2C, SPEED_DEG_S, round(angles[0] * 100) % 36000)
    body += b"".join(struct.pack("<HB", min(int(found), 0xFFFF), 200 if found else 0) for found in ranges)
    body += struct.pack("<HH", round(angles[-1] * 100) % 36000, int(time_s * 1000) % 30000)
    return body + bytes([crc8(body)])


class Ld19Device:
    """Streams from power-on; what its transmitter cannot keep is not sent."""

    def __init__(
        self,
        wire: PacedWire,
        clock: EmulatedClock,
        sight: Sight = room,
        *,
        clock_offset_s: float = 0.0,
        ppm: float = 0.0,
    ) -> None:
        self._sight = sight
        self._wire = wire
        self._clock = clock
        self._clock_offset_s = clock_offset_s
        self._ppm = ppm
        self._number = 0
        self.skipped = 0

    def receive(self, data: bytes) -> None:
        """The line is one-way: nothing is heard."""

    def collect(self) -> None:
        """Send the packets that are due and of which it is known what they saw."""
        now_s = self._clock.now_s()
        while (time_s := (self._number + 1) / RATE_HZ) <= now_s:
            if now_s - time_s > MAX_LAG_S or self._wire.backlog_s(now_s) > MAX_BACKLOG_S:
                self.skipped += 1
            elif (ranges := self._sight(angles_of(self._number), time_s)) is None:
                return
            else:
                device_s = self._clock_offset_s + time_s * (1.0 + self._ppm * 1e-6)
                self._wire.send(packet(self._number, device_s, ranges), time_s)
            self._number += 1

    def stop(self) -> None:
        """Nothing runs by itself."""
