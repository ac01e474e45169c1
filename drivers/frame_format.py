"""The layout of one frame of a streaming scanner, as values: what ``config/scanners/*.yaml`` says, checked.

A frame is ``sync | header fields | points | trailer fields | checksum``, always the same length. Devices whose frames
vary in length, or that must be asked for each profile, need a driver class of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

Scalar = Literal["u8", "i8", "u16", "i16", "u32", "i32", "f32"]
ByteOrder = Literal["little", "big"]
Algorithm = Literal["none", "sum8", "xor8", "crc8", "crc16", "crc32"]

CHECKSUM_BYTES: dict[Algorithm, int] = {"none": 0, "sum8": 1, "xor8": 1, "crc8": 1, "crc16": 2, "crc32": 4}


@dataclass(frozen=True, slots=True)
class Field:
    """One number in header or trailer; ``const`` is what it must hold in a good frame."""

    name: str
    scalar: Scalar
    const: int | None = None


@dataclass(frozen=True, slots=True)
class Scaling:
    """``value = raw * scale + offset`` in metres."""

    scale_m: float
    offset_m: float = 0.0


@dataclass(frozen=True, slots=True)
class PointArray:
    """The measurements of one frame.

    ``xz``: each item holds x and z. ``z``: each item holds z, x lies on a grid. ``polar``: each item holds a range, the
    angle runs evenly from the header's first to its last angle; x = r sin(angle), z = r cos(angle).
    """

    layout: Literal["xz", "z", "polar"]
    count: int
    item: tuple[Field, ...]
    """Numbers of one measurement: x, z, range, intensity; other names are skipped."""
    scaling: Scaling
    """Of z, or of range."""
    invalid: tuple[int, ...] = ()
    """Raw values of z or range that mean: nothing measured."""
    x_scaling: Scaling = Scaling(1.0)
    x_start_m: float = 0.0
    x_step_m: float = 0.0
    first_angle: str = ""
    last_angle: str = ""
    angle_unit_rad: float = 0.0
    angle_offset_rad: float = 0.0
    """Added to the device's angle so that 0 points along z, forward."""
    angle_sign: int = 1
    """-1 where the device counts clockwise and x points the other way."""


@dataclass(frozen=True, slots=True)
class CounterField:
    """A header or trailer field that counts and wraps: device time (``unit_s``) or sequence number."""

    field: str
    modulus: int
    unit_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Checksum:
    """The frame's last bytes: over everything from ``from_byte`` up to them. CRC parameters as in Williams' model."""

    algorithm: Algorithm = "none"
    from_byte: int = 0
    poly: int = 0
    init: int = 0
    xor_out: int = 0
    reflected: bool = False

    @property
    def width(self) -> int:
        """Bytes it takes on the wire."""
        return CHECKSUM_BYTES[self.algorithm]


@dataclass(frozen=True, slots=True)
class Command:
    """Bytes sent to the device and the literal answer it gives; an empty ``ack`` means that it gives none."""

    send: bytes
    ack: bytes = b""


@dataclass(frozen=True)
class FrameFormat:
    """The whole frame. Raises ValueError where its parts do not fit together."""

    sync: bytes
    byte_order: ByteOrder
    header: tuple[Field, ...]
    points: PointArray
    trailer: tuple[Field, ...] = ()
    checksum: Checksum = Checksum()
    clock: CounterField | None = None
    sequence: CounterField | None = None
    start: Command | None = None
    """Laser on; None for a device that streams as soon as it has power."""
    stop: Command | None = None
    confirmed_by_next: bool = False
    """A frame counts only once the next one's sync bytes stand right behind it: for devices that stream without pauses
    and have a weak checksum. Each profile comes that much later."""

    def __post_init__(self) -> None:
        if not self.sync:
            raise ValueError("a frame needs at least one sync byte")
        names = [field.name for field in self.header + self.trailer]
        if len(set(names)) != len(names) or {"sync", "points", "checksum"} & set(names):
            raise ValueError("field names are unique and none is called sync, points or checksum")
        needed = [counter.field for counter in (self.clock, self.sequence) if counter]
        if self.points.layout == "polar":
            needed += [self.points.first_angle, self.points.last_angle]
        for name in needed:
            if name not in names:
                raise ValueError(f"no header or trailer field is called {name!r}")
        required = {"xz": {"x", "z"}, "z": {"z"}, "polar": {"range"}}[self.points.layout]
        if not required <= {field.name for field in self.points.item}:
            raise ValueError(f"points of layout {self.points.layout} need the items {sorted(required)}")
        if not 0 <= self.checksum.from_byte < self.size - self.checksum.width:
            raise ValueError("the checksum starts inside the frame")

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """The frame as a packed numpy structured type."""
        item = np.dtype([(field.name, self._code(field.scalar)) for field in self.points.item])
        parts: list[Any] = [("sync", "u1", (len(self.sync),))]
        parts += [(field.name, self._code(field.scalar)) for field in self.header]
        parts += [("points", item, (self.points.count,))]
        parts += [(field.name, self._code(field.scalar)) for field in self.trailer]
        if self.checksum.width:
            parts += [("checksum", f"{self._order}u{self.checksum.width}")]
        return np.dtype(parts)

    @property
    def size(self) -> int:
        """Bytes of one frame on the wire."""
        return int(self.dtype.itemsize)

    @property
    def constants(self) -> tuple[tuple[str, int], ...]:
        """(name, value) of every field that must hold one value."""
        return tuple((field.name, field.const) for field in self.header + self.trailer if field.const is not None)

    @property
    def _order(self) -> str:
        return "<" if self.byte_order == "little" else ">"

    def _code(self, scalar: Scalar) -> str:
        return f"{self._order}{scalar[0]}{int(scalar[1:]) // 8}"
