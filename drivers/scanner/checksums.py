"""Checksums of many equal frames at once.

A CRC is linear over GF(2): the CRC of a message is the XOR of one table entry for each (position, byte), plus a
constant from the initial register. For frames of one length these tables are made once, and a batch of frames costs one
gather and one XOR reduction, whatever the polynomial (parameters as in R. Williams, "A painless guide to CRC error
detection algorithms", 1993).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from drivers.frame_format import Checksum

CRC32_OF_ZIP = Checksum("crc32", poly=0x04C11DB7, init=0xFFFFFFFF, xor_out=0xFFFFFFFF, reflected=True)
"""The one that the standard library computes faster still."""

Bytes2d = NDArray[np.uint8]
Sums = NDArray[np.uint32]


def checksum_function(checksum: Checksum, length: int) -> Callable[[Bytes2d], Sums]:
    """A function from frames' covered bytes (N, length) to their checksums (N,)."""
    checksum = replace(checksum, from_byte=0)
    if checksum.algorithm == "none":
        return lambda frames: np.zeros(len(frames), np.uint32)
    if checksum.algorithm == "sum8":
        return lambda frames: frames.sum(axis=1, dtype=np.uint32) & np.uint32(0xFF)
    if checksum.algorithm == "xor8":
        return lambda frames: np.bitwise_xor.reduce(frames, axis=1).astype(np.uint32)
    if checksum == CRC32_OF_ZIP:
        return lambda frames: np.array([zlib.crc32(frame) for frame in np.ascontiguousarray(frames)], np.uint32)
    return _crc_function(checksum, length)


@cache  # 4 MB of tables for a frame of 4 kB, a few milliseconds to make
def _crc_function(checksum: Checksum, length: int) -> Callable[[Bytes2d], Sums]:
    width = 8 * checksum.width
    byte_table = _byte_table(checksum.poly, width, checksum.reflected)
    tables = np.empty((length, 256), np.uint32)
    tables[length - 1] = byte_table
    for position in range(length - 2, -1, -1):
        tables[position] = _shift_in_zero(tables[position + 1], byte_table, width, checksum.reflected)
    register = np.array([_reflect(checksum.init, width) if checksum.reflected else checksum.init], np.uint32)
    for _ in range(length):
        register = _shift_in_zero(register, byte_table, width, checksum.reflected)
    constant = np.uint32(int(register[0]) ^ checksum.xor_out)
    positions = np.arange(length)

    def crc(frames: Bytes2d) -> Sums:
        return np.asarray(np.bitwise_xor.reduce(tables[positions, frames], axis=1) ^ constant, np.uint32)

    return crc


def _byte_table(poly: int, width: int, reflected: bool) -> Sums:
    """The CRC register (256,) after one byte went into a register of zeros."""
    mask, top = (1 << width) - 1, 1 << (width - 1)
    entries = []
    for byte in range(256):
        register = (_reflect(byte, 8) if reflected else byte) << (width - 8)
        for _ in range(8):
            register = ((register << 1) ^ poly if register & top else register << 1) & mask
        entries.append(_reflect(register, width) if reflected else register)
    return np.array(entries, np.uint32)


def _shift_in_zero(register: Sums, byte_table: Sums, width: int, reflected: bool) -> Sums:
    """Registers (N,) after one further zero byte."""
    shifted: Sums
    if reflected:
        shifted = (register >> np.uint32(8)) ^ byte_table[register & np.uint32(0xFF)]
    else:
        mask = np.uint32((1 << width) - 1)
        shifted = ((register << np.uint32(8)) & mask) ^ byte_table[register >> np.uint32(width - 8)]
    return shifted


def _reflect(value: int, width: int) -> int:
    return int(f"{value:0{width}b}"[::-1], 2)
