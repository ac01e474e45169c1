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
        unknown = set(values) - {"point_mm", "flange_mm_rad"}
        poses = np.asarray(values["flange_mm_rad"], dtype=np.float64)
        point_mm = np.asarray(values.get("point_mm", [0.0, 0.0, 0.0]), dtype=np.float64)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        problem = str(error).replace("\n", " ")
        raise InputError(f"{path} holds no touches: {problem}", remedy=REMEDY) from error
    finite = np.isfinite(poses).all() and np.isfinite(point_mm).all()
    if unknown:
        raise InputError(f"{path}: '{sorted(map(str, unknown))[0]}' is not known there", remedy=REMEDY)
    if poses.ndim != 2 or poses.shape[1] != 6 or point_mm.shape != (3,) or not finite:
        raise InputError(f"{path} holds no touches: rows of six finite numbers are wanted", remedy=REMEDY)
    return Touches(tuple(Pose.from_rotvec(row[3:], row[:3] / 1e3) for row in poses), point_mm / 1e3)


REMEDY = "Give flange_mm_rad: rows of x, y, z, rx, ry, rz (docs/calibration.md)."
