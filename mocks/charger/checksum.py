"""The mock's own checksums, bit by bit: a second opinion on the driver's tables, and slow enough not to matter here.

Data id low byte, high byte, then every byte of the frame but the checksum's own (CRC-8); for the 16-bit profile the
data id comes last.
"""

from __future__ import annotations


def remainder(data: bytes, polynomial: int, width: int, start: int) -> int:
    """Remainder of the polynomial division, most significant bit first."""
    register = start
    for byte in data:
        register ^= byte << (width - 8)
        for _ in range(8):
            carry = register >> (width - 1)
            register = (register << 1) & ((1 << width) - 1)
            if carry:
                register ^= polynomial
    return register


SIZES = {"e2e-p11": 1, "j1850": 1, "e2e-p5": 2}


def protect(frame: bytearray, scheme: str, data_id: int, at: int = 0) -> None:
    """Put the checksum into the frame, from byte ``at`` on."""
    size = SIZES.get(scheme, 0)
    identity, rest = bytes((data_id & 0xFF, data_id >> 8)), bytes(frame[:at] + frame[at + size :])
    if scheme == "e2e-p11":
        frame[at] = remainder(identity + rest, 0x1D, 8, 0x00)
    elif scheme == "j1850":
        frame[at] = remainder(identity + rest, 0x1D, 8, 0xFF) ^ 0xFF
    elif scheme == "e2e-p5":
        value = remainder(rest + identity, 0x1021, 16, 0xFFFF)
        frame[at], frame[at + 1] = value & 0xFF, value >> 8


def fits(frame: bytes, scheme: str, data_id: int, at: int = 0) -> bool:
    """Whether the frame's checksum is its own."""
    again = bytearray(frame)
    protect(again, scheme, data_id, at)
    return bytes(again) == bytes(frame)
