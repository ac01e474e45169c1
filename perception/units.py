"""Length units of files, and the check that catches a wrong one before anything is computed from it."""

from __future__ import annotations

from typing import Literal

import numpy as np

from perception.errors import UnitError
from perception.geometry import Array

LengthUnit = Literal["m", "cm", "mm"]
METRES_PER: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}

SCAN_EXTENT_M = (0.02, 5.0)
"""A scan of a port covers at least the port's insert and at most the side of a car."""
MODEL_EXTENT_M = (0.015, 0.6)
"""The smallest inlet is 30 mm wide; no inlet with its flange is larger than 0.3 m."""


def scale_of(unit: str) -> float:
    """Metres in one ``unit``. Raises UnitError for another unit than m, cm, mm."""
    if unit not in METRES_PER:
        raise UnitError(f"unknown length unit {unit!r}", remedy="Use m, cm or mm.")
    return METRES_PER[unit]


def check_extent(points: Array, limits_m: tuple[float, float], what: str, option: str) -> None:
    """Raises UnitError when the bulk of ``points`` (N, 3), in metres, has a size that no ``what`` has."""
    low, high = np.percentile(points, [2, 98], axis=0) if len(points) > 1000 else (points.min(0), points.max(0))
    extent = float((high - low).max())
    if not limits_m[0] <= extent <= limits_m[1]:
        raise UnitError(
            f"{what} measures {extent:.4g} m across: the unit is wrong, or it shows no charging port",
            remedy=f"Name the unit of the data with {option} m|cm|mm.",
        )
