"""Port descriptions: from YAML (``config/ports/NAME.yaml`` or any file) to the values that perception works with.

Keys carry their unit (``depth_mm``, ``draft_deg``); the values that come out are SI. A key that is not known is refused
with the nearest one named: a mistyped dimension must never silently fall back to a default.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar

import yaml

from perception.errors import InputError, UnknownPortError
from perception.port_shape import Common, Disc, Hull, Outline, Point2, PortDescription, RoundedRect

_UNITS = {"_m": ("_mm", 1e-3), "_rad": ("_deg", math.pi / 180)}
_OUTLINES: dict[str, Any] = {"disc": Disc, "rounded_rect": RoundedRect, "hull": Hull, "common": Common}
_LARGEST = 1000.0
"""No port measures more than this many millimetres or degrees: beyond it the unit is wrong."""


class PortFileError(InputError):
    """A port description is not what it should be."""

    code: ClassVar[str] = "port-file"
    default_remedy: ClassVar[str] = "Correct the description; a bundled one in config/ports shows every key."


def bundled_ports() -> tuple[str, ...]:
    """Names of the ports that portdock brings along, sorted."""
    files = resources.files("config.ports").iterdir()
    return tuple(sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml")))


def load_port(name_or_path: str | Path) -> PortDescription:
    """A bundled port by name, or a description by its path. Raises UnknownPortError or PortFileError."""
    if str(name_or_path).endswith((".yaml", ".yml")):
        return parse_port(_read_text(Path(name_or_path)), str(name_or_path))
    if str(name_or_path) not in bundled_ports():
        raise UnknownPortError(
            f"no port is called {str(name_or_path)!r}{_nearest(str(name_or_path), bundled_ports())}",
            remedy=f"Use one of {', '.join(bundled_ports())}, or the path of a mesh file.",
        )
    return _bundled(str(name_or_path))


@cache
def _bundled(name: str) -> PortDescription:
    return parse_port((resources.files("config.ports") / f"{name}.yaml").read_text("utf-8"), f"{name}.yaml")


def _read_text(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise PortFileError(f"{path} cannot be read: {error}", remedy="Check the path.") from error


def parse_port(text: str, where: str) -> PortDescription:
    """The description in a YAML text; ``where`` names the file in errors. Raises PortFileError."""
    try:
        node = yaml.safe_load(text)
    except yaml.YAMLError as error:
        problem = str(error).replace("\n", " ")
        raise PortFileError(f"{where} is not YAML: {problem}", remedy="Correct the line named above.") from error
    if isinstance(node, dict) and isinstance(node.get("shape"), dict):
        node = {**node, "shape": {"name": node.get("name"), **node["shape"]}}
    description: PortDescription = _record(PortDescription, node, where)
    return description


def _record(cls: Any, node: Any, where: str) -> Any:
    """A dataclass from a mapping whose keys are its fields, lengths in mm and angles in degrees."""
    if not isinstance(node, dict):
        raise PortFileError(f"{where}: a mapping is wanted, not {node!r}")
    hints = typing.get_type_hints(cls)
    fields = {_key(field.name): field for field in dataclasses.fields(cls)}
    for key in node:
        if key not in fields:
            raise PortFileError(f"{where}: unknown key {key!r}{_nearest(str(key), tuple(fields))}")
    values: dict[str, Any] = {}
    for key, field in fields.items():
        if key in node:
            values[field.name] = _value(hints[field.name], node[key], f"{where}: {key}", _scale(field.name))
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise PortFileError(f"{where}: {key} is missing")
    return cls(**values)


def _value(hint: Any, node: Any, where: str, scale: float) -> Any:
    """One value of the type that ``hint`` names."""
    if hint == Outline:
        return _outline(node, where)
    if hint == Point2:
        return _point(node, where, scale)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        inner = [argument for argument in arguments if argument is not types.NoneType]
        return None if node is None else _value(inner[0], node, where, scale)
    if origin is tuple:
        if not isinstance(node, list):
            raise PortFileError(f"{where}: a list is wanted, not {node!r}")
        return tuple(_value(arguments[0], item, f"{where}[{k}]", scale) for k, item in enumerate(node))
    if origin is typing.Literal:
        if node not in arguments:
            raise PortFileError(f"{where}: {node!r} is none of {', '.join(map(str, arguments))}")
        return node
    if dataclasses.is_dataclass(hint):
        return _record(hint, node, where)
    if hint is float:
        return _number(node, where) * scale
    if not isinstance(node, hint):
        raise PortFileError(f"{where}: {hint.__name__} is wanted, not {node!r}")
    return node


def _outline(node: Any, where: str) -> Outline:
    """An outline from a mapping with its kind as the only key."""
    if not isinstance(node, dict) or len(node) != 1:
        raise PortFileError(f"{where}: one of {', '.join(_OUTLINES)} is wanted, not {node!r}")
    ((kind, body),) = node.items()
    if kind not in _OUTLINES:
        raise PortFileError(f"{where}: unknown outline {kind!r}{_nearest(str(kind), tuple(_OUTLINES))}")
    where = f"{where}.{kind}"
    if kind in ("hull", "common"):
        if not isinstance(body, list) or not body:
            raise PortFileError(f"{where}: a list of outlines is wanted")
        parts = tuple(_outline(part, f"{where}[{k}]") for k, part in enumerate(body))
        return Hull(parts) if kind == "hull" else Common(parts)
    outline: Outline = _record(_OUTLINES[kind], body, where)
    return outline


def _point(node: Any, where: str, scale: float) -> Point2:
    if not isinstance(node, list) or len(node) != 2:
        raise PortFileError(f"{where}: [x, y] is wanted, not {node!r}")
    return _number(node[0], where) * scale, _number(node[1], where) * scale


def _number(node: Any, where: str) -> float:
    if isinstance(node, bool) or not isinstance(node, int | float) or not math.isfinite(node):
        raise PortFileError(f"{where}: a number is wanted, not {node!r}")
    if abs(node) > _LARGEST:
        raise PortFileError(f"{where}: {node} is more than {_LARGEST:.0f} mm or degrees", remedy="Check the unit.")
    return float(node)


def _key(field: str) -> str:
    """The YAML key of a field: the same with the unit that people use."""
    for unit, (shown, _) in _UNITS.items():
        if field.endswith(unit):
            return field.removesuffix(unit) + shown
    return field


def _scale(field: str) -> float:
    return next((scale for unit, (_, scale) in _UNITS.items() if field.endswith(unit)), 1.0)


def _nearest(word: str, known: tuple[str, ...]) -> str:
    match = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {match[0]!r}?" if match else ""
