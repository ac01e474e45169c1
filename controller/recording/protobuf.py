"""The raw records of a recording: protobuf messages of fixed layout, packed with ``struct`` and numpy.

Each message is valid protobuf (Foxglove and every protobuf library read and plot it), yet every field is always
present, in order and of fixed width: one ``struct`` call writes a record and numpy decodes a whole stream at once.
The descriptors that a recording carries beside the records are built here too. No protobuf library is needed, and
this module decodes only what it wrote itself: fields in another order are refused.

Source: protobuf encoding guide (tag = number << 3 | wire type; type 1 is 8 bytes, 2 length-delimited, 5 is 4 bytes)
and descriptor.proto (field numbers of FileDescriptorSet).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

Kind = Literal["double", "doubles", "bool", "int", "uint", "time_ns", "bytes"]

_WIRE_TYPES: dict[Kind, int] = {"double": 1, "doubles": 2, "bool": 0, "int": 5, "uint": 5, "time_ns": 1, "bytes": 2}
# descriptor.proto, FieldDescriptorProto.Type: TYPE_DOUBLE 1, FIXED64 6, FIXED32 7, BOOL 8, BYTES 12, SFIXED32 15
_DESCRIPTOR_TYPES: dict[Kind, int] = {
    "double": 1,
    "doubles": 1,
    "bool": 8,
    "int": 15,
    "uint": 7,
    "time_ns": 6,
    "bytes": 12,
}
_STRUCT_CODES: dict[Kind, str] = {"double": "d", "bool": "?", "int": "i", "uint": "I", "time_ns": "Q"}


@dataclass(frozen=True, slots=True)
class Field:
    """One field; ``count`` is the fixed number of entries of kind ``doubles``."""

    name: str
    kind: Kind
    count: int = 1


@dataclass(frozen=True, slots=True)
class Layout:
    """A message: its name and its fields, numbered from 1 in this order. A ``bytes`` field, if any, is the last one."""

    name: str
    fields: tuple[Field, ...]

    def tag(self, index: int) -> bytes:
        """The encoded tag of the field at ``index``; field numbers stay below 16, so that a tag is one byte."""
        return bytes([(index + 1) << 3 | _WIRE_TYPES[self.fields[index].kind]])

    @property
    def struct(self) -> struct.Struct:
        """Fixed part of a record: a tag (``c``) and a value for each field but ``bytes``, little-endian, unpadded."""
        codes = ""
        for field in self.fields:
            if field.kind == "doubles":
                codes += f"2s{field.count}d"
            elif field.kind == "bytes":
                codes += "c"
            else:
                codes += "c" + _STRUCT_CODES[field.kind]
        return struct.Struct("<" + codes)

    @property
    def prefixes(self) -> tuple[bytes, ...]:
        """What precedes each field's value: its tag, and for ``doubles`` the length in bytes."""
        return tuple(
            self.tag(i) + (bytes([8 * field.count]) if field.kind == "doubles" else b"")
            for i, field in enumerate(self.fields)
        )

    def descriptor(self) -> bytes:
        """A serialised FileDescriptorSet, as MCAP's ``protobuf`` schema encoding asks for."""
        package, message_name = self.name.split(".")
        fields = b"".join(_field_descriptor(i + 1, field) for i, field in enumerate(self.fields))
        message = _text(1, message_name) + fields
        file = _text(1, f"{self.name}.proto") + _text(2, package) + _delimited(4, message) + _text(12, "proto3")
        return _delimited(1, file)


def _field_descriptor(number: int, field: Field) -> bytes:
    label = 3 if field.kind == "doubles" else 1  # LABEL_REPEATED, LABEL_OPTIONAL; proto3 packs repeated doubles
    body = _text(1, field.name) + _integer(3, number) + _integer(4, label)
    return _delimited(2, body + _integer(5, _DESCRIPTOR_TYPES[field.kind]))


def varint(value: int) -> bytes:
    """A non-negative integer in base 128, least significant group first."""
    groups = bytearray()
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*groups, value])


def read_varint(data: bytes, offset: int) -> tuple[int, int]:
    """The integer at ``offset`` and the offset behind it. Raises ValueError if it does not end."""
    value = 0
    for k in range(10):
        if offset + k >= len(data):
            break
        value |= (data[offset + k] & 0x7F) << 7 * k
        if data[offset + k] < 0x80:
            return value, offset + k + 1
    raise ValueError("a length in the record does not end")


def _delimited(number: int, body: bytes) -> bytes:
    return bytes([number << 3 | 2]) + varint(len(body)) + body


def _text(number: int, text: str) -> bytes:
    return _delimited(number, text.encode())


def _integer(number: int, value: int) -> bytes:
    return bytes([number << 3]) + varint(value)
