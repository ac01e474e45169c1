"""The newest decoded message of each name, by a DBC of a vehicle's protocol, with its time. Pure."""

from __future__ import annotations

import importlib.resources
import math
from collections import Counter
from pathlib import Path
from typing import Any

import cantools


class NewestMessages:
    """Decodes through a DBC that comes with portdock and keeps the newest values of each message."""

    def __init__(self, dbc: str) -> None:
        path = Path(str(importlib.resources.files("config") / "dbc" / dbc))
        self.database: Any = cantools.database.load_file(path, strict=True)
        self._values: dict[str, tuple[float, dict[str, float]]] = {}
        self.counters: Counter[str] = Counter()
        self.newest_s = -math.inf

    def take(self, message: Any, data: bytes, now_s: float) -> bool:
        """Decode and keep; False for data that does not fit. Bytes beyond the DBC's length belong to newer editions."""
        try:
            values = message.decode(data[: message.length], decode_choices=False, allow_truncated=True)
        except (cantools.database.errors.DecodeError, ValueError):
            values = {}
        if not values:
            self.counters["bad_frames"] += 1
            return False
        self._values[message.name] = (now_s, values)
        self.newest_s = now_s
        self.counters["messages"] += 1
        return True

    def heard_s(self, name: str) -> float:
        """When a message came last; -inf before the first."""
        return self._values[name][0] if name in self._values else -math.inf

    def value(self, name: str, signal: str, now_s: float, within_s: float) -> float:
        """A signal of a message that is not older than ``within_s``; NaN otherwise."""
        if now_s - self.heard_s(name) > within_s:
            return math.nan
        return float(self._values[name][1].get(signal, math.nan))
