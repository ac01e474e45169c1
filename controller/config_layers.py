"""The layers of the configuration, lowest first: ``default.yaml``, a bundled site, the site file; and who set a key."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from controller.config_section import ConfigError

BUILT_IN = "built in"
"""Origin of a key that no layer sets."""


@dataclass(frozen=True, slots=True)
class Layer:
    """One YAML file of the configuration as read."""

    name: str
    values: dict[str, Any]


def layers(path: Path | None = None, scanner: str | None = None) -> tuple[Layer, ...]:
    """The defaults, the bundled site of a scanner, the site file at ``path``. Raises ConfigError."""
    found = [_layer(resources.files("config").joinpath("default.yaml").read_text(), "default.yaml")]
    if scanner is not None:
        if scanner not in scanner_sites():
            raise ConfigError(
                f"no bundled site has a scanner {scanner}", remedy=f"Use one of {', '.join(scanner_sites())}."
            )
        text = resources.files("config").joinpath("sites", f"{scanner}.yaml").read_text()
        found.append(_layer(text, f"sites/{scanner}.yaml"))
    if path is not None:
        found.append(_layer(_text(path), str(path)))
    return tuple(found)


def scanner_sites() -> list[str]:
    """Names of the bundled sites' scanners: what ``layers`` takes as ``scanner``."""
    folder = resources.files("config") / "sites"
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def merged(found: Iterable[Layer]) -> dict[str, Any]:
    """All layers in one, the later above the earlier, section by section."""
    values: dict[str, Any] = {}
    for layer in found:
        values = _on_top(values, layer.values)
    return values


def origins(found: Iterable[Layer]) -> dict[str, str]:
    """The layer that sets a key, by the key's dotted name; keys that no layer names are left out."""
    return {key: layer.name for layer in found for key in _dotted(layer.values)}


def origin(key: str, known: dict[str, str]) -> str:
    """Which layer set a key: a list or mapping that is set as a whole sets what is in it."""
    while key:
        if key in known:
            return known[key]
        key = key.rpartition(".")[0]
    return BUILT_IN


def _layer(text: str, name: str) -> Layer:
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        where = getattr(error, "problem_mark", None)
        line = f" at line {where.line + 1}, column {where.column + 1}" if where else ""
        problem = getattr(error, "problem", None) or "not YAML"
        raise ConfigError(f"{name} is not valid YAML{line}: {problem}", remedy="Correct that line.") from error
    if values is not None and not isinstance(values, dict):
        raise ConfigError(f"{name} is not a YAML mapping of sections")
    return Layer(name, values or {})


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read {path}: {error}", remedy="Give the path of a readable YAML file.") from error


def _on_top(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    result = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = _on_top(result[key], value) if both else value
    return result


def _dotted(values: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, dict) and value:
            yield from _dotted(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"
