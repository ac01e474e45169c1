"""Where a point of the plug is at the flange: from touching one fixed point with it in several poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.calibration.errors import CalibrationError
from perception.geometry import Array, Pose

MIN_TOUCHES = 4
MAX_CONDITION = 30.0
"""Of the touches' orientations: they must differ about two axes."""
MAX_RESIDUAL_M = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class ToolPoint:
    """A point of the tool found by touching."""

    in_flange: Array
    """(3,) metres."""
    touched: Array
    """(3,) where the fixed point is, base frame."""
    covariance: Array
    """(3, 3) of ``in_flange``."""
    residuals_m: Array
    """(n,) distance of each touch."""


def tool_point(T_base_flange: Sequence[Pose]) -> ToolPoint:
    """The tool's point that touched one fixed point in every flange pose (linear least squares).

    :raises CalibrationError: fewer than four touches, orientations that are too much alike, or touches that disagree
    """
    if len(T_base_flange) < MIN_TOUCHES:
        raise CalibrationError(f"{len(T_base_flange)} touches are too few: at least {MIN_TOUCHES}")
    rows = np.vstack([np.hstack([pose.rotation, -np.eye(3)]) for pose in T_base_flange])
    right = -np.concatenate([pose.translation for pose in T_base_flange])
    if np.linalg.cond(rows) > MAX_CONDITION:
        raise CalibrationError(
            "the touches' orientations are too much alike",
            remedy="Turn the flange by 30 deg and more about two axes between touches.",
        )
    solution = np.linalg.lstsq(rows, right, rcond=None)[0]
    off = (rows @ solution - right).reshape(-1, 3)
    distances = np.linalg.norm(off, axis=1)
    if distances.max() > MAX_RESIDUAL_M:
        worst = int(distances.argmax())
        raise CalibrationError(
            f"touch {worst + 1} is {1e3 * distances[worst]:.1f} mm off the others' point",
            remedy="Touch the same point each time, with the same part of the plug.",
        )
    noise = float(np.sum(off**2) / max(1, off.size - 6))
    covariance = noise * np.linalg.inv(rows.T @ rows)[:3, :3]
    return ToolPoint(solution[:3], solution[3:], covariance, distances)
