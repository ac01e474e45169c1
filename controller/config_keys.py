"""Every key of the configuration with unit, bounds and meaning: the listing, and the JSON Schema for editors."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import yaml

from controller.config import SiteConfig
from controller.config_layers import Layer, origin, origins
from controller.config_units import unit_of

_BOUNDS = {"exclusiveMinimum": "> {:g}", "minimum": ">= {:g}", "exclusiveMaximum": "< {:g}", "maximum": "<= {:g}"}


@dataclass(frozen=True, slots=True)
class ConfigKey:
    """What can be said of one key."""

    name: str
    """Dotted: ``scan.speed_mm_s``."""
    unit: str | None
    bounds: str
    """``> 0, <= 100``, or the choices; empty for a key without."""
    doc: str


def keys() -> tuple[ConfigKey, ...]:
    """Every key of the site configuration, in the order of its sections."""
    schema = SiteConfig.model_json_schema()
    return tuple(_keys(schema, schema["$defs"], ""))


def json_schema() -> str:
    """The JSON Schema of a site file, with each key's unit in its description, for editors."""
    schema = SiteConfig.model_json_schema()
    for part in (schema, *schema["$defs"].values()):
        for name, entry in part.get("properties", {}).items():
            unit = unit_of(name)
            said = " ".join(entry.get("description", "").split())
            entry["description"] = f"[{unit}] {said}".rstrip() if unit else said
    schema["title"] = "portdock site file"
    return json.dumps({"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}, indent=2)


def listing(config: SiteConfig, found: Iterable[Layer], with_docs: bool) -> str:
    """Every key with its effective value as YAML; behind each its origin, with ``with_docs`` what it means above it."""
    known, about = origins(found), {key.name: key for key in keys()}
    return "\n".join(_lines(config.model_dump(mode="json"), "", known, about if with_docs else None)) + "\n"


def _lines(
    values: dict[str, Any], prefix: str, known: dict[str, str], about: dict[str, ConfigKey] | None
) -> Iterator[str]:
    indent = "  " * prefix.count(".")
    for name, value in values.items():
        key = f"{prefix}{name}"
        if about and key in about and (said := _said(about[key])):
            yield f"{indent}# {said}"
        if isinstance(value, dict) and value:
            yield f"{indent}{name}:"
            yield from _lines(value, f"{key}.", known, about)
        else:
            yield f"{indent}{name}: {_flow(value)}  # {origin(key, known)}"
            if about and value is None:
                yield from _left_out(key, indent, about)


def _left_out(section: str, indent: str, about: dict[str, ConfigKey]) -> Iterator[str]:
    """The keys of a section that the site does not have, as comments."""
    for key in about.values():
        parent, _, name = key.name.rpartition(".")
        if parent == section:
            yield f"{indent}#   {name}: {_said(key)}"


def _said(key: ConfigKey) -> str:
    """``(mm; > 0, <= 200) Gap between plug and rim plane.``"""
    facts = "; ".join(part for part in (key.unit, key.bounds) if part)
    return " ".join(part for part in (f"({facts})" if facts else "", key.doc) if part)


def _flow(value: Any) -> str:
    """A value on one line of YAML."""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000).strip()
    return text.removesuffix("...").strip()


def _keys(part: dict[str, Any], sections: dict[str, Any], prefix: str) -> Iterator[ConfigKey]:
    for name, entry in part.get("properties", {}).items():
        parts = (entry, *entry.get("allOf", ()), *entry.get("anyOf", ()))  # anyOf: a section that may be left out
        reference = next((one["$ref"] for one in parts if "$ref" in one), "")
        section = sections.get(reference.rpartition("/")[2])
        key = f"{prefix}{name}"
        doc = " ".join(entry.get("description", (section or {}).get("description", "")).split())
        yield ConfigKey(key, unit_of(name), _bounds(entry), doc)
        if section is not None and section.get("type") == "object":
            yield from _keys(section, sections, f"{key}.")


def _bounds(entry: dict[str, Any]) -> str:
    """Bounds or choices of a key, also of one that may be null."""
    for one in (entry, *entry.get("anyOf", ())):
        if "enum" in one:
            return "one of " + ", ".join(map(str, one["enum"]))
        said = [text.format(one[name]) for name, text in _BOUNDS.items() if name in one]
        if said:
            return ", ".join(said)
    return ""
