"""The vehicle's inlet as a file in the run's folder: ``port_shape.json``. Whoever starts the mock writes it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from perception import port_shape
from perception.port_shape import PortShape

FILE_NAME = "port_shape.json"


def save_shape(shape: PortShape, folder: Path) -> None:
    """Write the shape for ``load_shape``."""
    (folder / FILE_NAME).write_text(json.dumps(_plain(shape), indent=1))


def load_shape(folder: Path) -> PortShape:
    """Read what ``save_shape`` wrote. Raises FileNotFoundError, ValueError."""
    shape = _value(json.loads((folder / FILE_NAME).read_text()))
    if not isinstance(shape, PortShape):
        raise ValueError(f"{folder / FILE_NAME} holds no port shape")
    return shape


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        fields = {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"type": type(value).__name__, **fields}
    return [_plain(entry) for entry in value] if isinstance(value, tuple) else value


def _value(plain: Any) -> Any:
    if isinstance(plain, list):
        return tuple(_value(entry) for entry in plain)
    if not isinstance(plain, dict):
        return plain
    kind = getattr(port_shape, str(plain.pop("type", "")), None)
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        raise ValueError("a port shape is made of the types of perception.port_shape")
    return kind(**{name: _value(entry) for name, entry in plain.items()})
