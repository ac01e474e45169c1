"""A port's shape as text, so that processes which know no YAML (the mocks) can be handed one."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from perception import port_shape
from perception.port_shape import PortShape

_KINDS: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        port_shape.PortShape,
        port_shape.Disc,
        port_shape.RoundedRect,
        port_shape.Hull,
        port_shape.Common,
        port_shape.Hole,
        port_shape.Flange,
        port_shape.Cavity,
        port_shape.Insert,
        port_shape.Contact,
        port_shape.Key,
        port_shape.Finish,
    )
}


def shape_to_json(shape: PortShape) -> str:
    """The shape as JSON; each record names its type."""
    return json.dumps(_encoded(shape), indent=1)


def shape_from_json(text: str) -> PortShape:
    """The shape that ``shape_to_json`` wrote. Raises ValueError for anything else."""
    shape = _decoded(json.loads(text))
    if not isinstance(shape, PortShape):
        raise ValueError("not a port's shape")
    return shape


def _encoded(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: _encoded(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"type": type(value).__name__, **fields}
    return [_encoded(item) for item in value] if isinstance(value, tuple) else value


def _decoded(value: Any) -> Any:
    if isinstance(value, dict):
        kind = _KINDS.get(value.get("type", ""))
        if kind is None:
            raise ValueError(f"{value.get('type')!r} is no part of a port's shape")
        return kind(**{key: _decoded(item) for key, item in value.items() if key != "type"})
    return tuple(_decoded(item) for item in value) if isinstance(value, list) else value
