"""What a restart would change: the configuration that runs against the one on disk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from controller.calibrations.in_force import calibrated
from controller.config import SiteConfig, load_config
from perception.errors import PortdockError


def describe_changes(running: SiteConfig, path: Path | None) -> list[str]:
    """One line for each key that differs, or what is wrong with the file."""
    if path is None:
        return ["no site file was given: a restart changes nothing"]
    try:
        on_disk = calibrated(load_config(path))
    except PortdockError as error:
        return [f"{path} cannot be used: {error.cause}. {error.remedy}"]
    before, after = dict(_keys(running.model_dump())), dict(_keys(on_disk.model_dump()))
    changed = [key for key in sorted(before.keys() | after.keys()) if before.get(key) != after.get(key)]
    if not changed:
        return [f"{path} is what runs: a restart changes nothing"]
    return [f"a restart would change {key} from {before.get(key)} to {after.get(key)}" for key in changed]


def _keys(values: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted key and value of every leaf."""
    if isinstance(values, dict):
        for key, value in values.items():
            yield from _keys(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, values
