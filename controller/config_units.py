"""The unit of a configuration key, from the end of its name."""

from __future__ import annotations

_UNITS = {
    "mm": "mm", "um": "um", "deg": "deg", "s": "s", "ms": "ms", "n": "N", "nm": "Nm", "hz": "Hz", "kg": "kg", "a": "A",
    "bps": "bit/s", "percent": "%", "mb": "MB", "days": "d", "rate": "baud",
}  # fmt: skip
_RATES = {"mm_s2": "mm/s^2", "deg_s2": "deg/s^2", "mm_s": "mm/s", "deg_s": "deg/s"}


def unit_of(key: str) -> str | None:
    """The unit that a key's name ends with; None for a key without unit."""
    for ending, unit in _RATES.items():
        if key.endswith(f"_{ending}"):
            return unit
    return _UNITS.get(key.rsplit("_", 1)[-1]) if "_" in key else None
