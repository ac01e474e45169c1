"""Touches of one fixed point, written down from the pendant: a YAML file of flange poses.

point_mm: [0, 0, 0]   # which point of the plug touched, in its TCP frame; left out: the TCP itself
flange_mm_rad:        # x, y, z, rx, ry, rz in the base as the pendant shows them, with all zeros as active TCP
  - [912.3, 101.7, 402.9, 1.209, -1.209, -1.209]
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from perception.errors import InputError
from perception.geometry import Array, Pose

NEAREST_MM, FURTHEST_MM = 50.0, 3000.0
"""Of any flange from its base: other numbers are in another unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """What the file says."""

    T_base_flange: tuple[Pose, ...]
    point: Array
    """(3,) of the plug that touched, TCP frame, metres."""


def read_touches(path: Path) -> Touches:
    """Raises InputError for a file that cannot be read or is none."""
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}", remedy=REMEDY) from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path} is no YAML file: {' '.join(str(error).split())}", remedy=REMEDY) from error
    if not isinstance(values, dict) or "flange_mm_rad" not in values:
        raise InputError(f"{path} has no key 'flange_mm_rad'", remedy=REMEDY)
    unknown = sorted(map(str, set(values) - {"flange_mm_rad", "point_mm"}))
    if unknown:
        raise InputError(f"{path}: '{unknown[0]}' is not known there", remedy=REMEDY)
    poses = _numbers(values["flange_mm_rad"])
    point_mm = _numbers(values.get("point_mm", [0.0, 0.0, 0.0]))
    if poses.ndim != 2 or poses.shape[1] != 6 or point_mm.shape != (3,):
        raise InputError(f"{path}: rows of six finite numbers are wanted, and three for a point", remedy=REMEDY)
    away_mm = np.linalg.norm(poses[:, :3], axis=1)
    if not (away_mm.min() > NEAREST_MM and away_mm.max() < FURTHEST_MM):
        raise InputError(
            f"{path}: a flange {away_mm.min():.3g} to {away_mm.max():.3g} mm from the base: no arm reaches like that",
            remedy="Give x, y, z in millimetres and rx, ry, rz in radians.",
        )
    return Touches(tuple(Pose.from_rotvec(row[3:], row[:3] / 1e3) for row in poses), point_mm / 1e3)


def _numbers(values: object) -> Array:
    """Finite numbers, or none at all."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.zeros(0)
    return numbers if np.isfinite(numbers).all() else np.zeros(0)


REMEDY = "Give flange_mm_rad: rows of x, y, z, rx, ry, rz (docs/calibration.md)."
