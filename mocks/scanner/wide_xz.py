"""The wide XZ profiler at byte level: encodes profiles, understands laser-on and laser-off, answers both.

Written from the description in ``config/scanners/wide_xz.yaml``, sharing no code with the driver. Unknown commands
are ignored, as a device without an error reply does. Not simulated: exposure control, intensity, temperature drift.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # SciPy behind it would double the time that a mock takes to come up
    from perception.geometry import Array

POINTS = 1000
NO_MEASUREMENT = 0xFFFF
LASER_ON, LASER_OFF = b"L1\r\n", b"L0\r\n"
_SYNC = b"\xa5\x5a\xc3\x3c"
_HEAD = struct.Struct("<HHII")


def encode(line: Array, sequence: int, time_s: float) -> bytes:
    """One frame of 4,020 bytes. ``line``: points (up to 1000, 2) in metres, NaN or out of range = not measured."""
    x, z = np.zeros(POINTS), np.full(POINTS, np.nan)
    x[: len(line)], z[: len(line)] = line[:POINTS, 0], line[:POINTS, 1]
    x_counts = np.round(x / 5e-6)
    z_counts = np.round((z - 0.1) / 10e-6)
    seen = np.isfinite(x_counts) & np.isfinite(z_counts)
    seen &= (np.abs(np.nan_to_num(x_counts)) < 32768) & (np.nan_to_num(z_counts, nan=-1.0) >= 0)
    seen &= np.nan_to_num(z_counts) < NO_MEASUREMENT
    pairs = np.empty((POINTS, 2), "<u2")
    pairs[:, 0] = np.where(seen, x_counts, 0).astype(np.int64) & 0xFFFF
    pairs[:, 1] = np.where(seen, z_counts, NO_MEASUREMENT).astype(np.int64)
    ticks = round(time_s * 1e6) & 0xFFFFFFFF
    body = _HEAD.pack(POINTS, 1, sequence & 0xFFFFFFFF, ticks) + pairs.tobytes()
    return _SYNC + body + struct.pack("<I", zlib.crc32(body))


def split_commands(data: bytes) -> tuple[list[bytes], bytes]:
    """Complete commands, each with its line end, and the unfinished rest (at most 64 bytes)."""
    *lines, rest = data.split(b"\r\n")
    return [line + b"\r\n" for line in lines], rest[-64:]


def answer(command: bytes) -> bytes:
    """The acknowledgement of a known command, nothing for others."""
    return b"OK " + command if command in (LASER_ON, LASER_OFF) else b""
