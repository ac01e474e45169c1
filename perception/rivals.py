"""What else might explain a scan: the port at another roll, or its mirror image. Points that tell them apart vote.

One point for each cell, of the cell's majority: votes, not density, and no vote from a lone flying point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

from perception.front_map import CELL_M, TOLERANCE_M, FrontMap, cell_points, rolled
from perception.geometry import Array

_ROLL_STEP_DEG = 4.0
_ROLL_FROM_DEG = 12.0
_DIFFERS_M2 = 2e-5
"""A port of which less differs from its mirror image is taken for its own."""
_MIRRORED = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """Places of a scan in the port's frame."""

    local: Array
    """(N, 3) points."""
    agrees: NDArray[np.bool_]
    """(N,) whether the port's surface is there."""
    tolerance_m: float


def votes_of(local: Array, misfit: Array, cell: NDArray[np.int64], tolerance_m: float) -> Votes:
    """The votes of points (N, 3) with their misfits (N,) and the numbers (N,) of their cells."""
    agrees = np.abs(misfit) < tolerance_m
    balance = np.bincount(cell, np.where(agrees, 1.0, -1.0))
    voter = np.where(agrees, balance[cell] >= 0, balance[cell] < -1.5)
    kept = np.flatnonzero(voter)
    first = kept[np.unique(cell[kept], return_index=True)[1]]
    return Votes(local[first], agrees[first], tolerance_m)


def rival_roll(votes: Votes, front: FrontMap) -> tuple[float, int, int]:
    """The other roll that explains the scan best: its angle (rad), and how many speak for this one and for that."""
    best = (0.0, 0, 0)
    lowest = np.inf
    for angle_deg in np.arange(_ROLL_FROM_DEG, 360.0 - _ROLL_FROM_DEG + 0.1, _ROLL_STEP_DEG):
        roll = float(np.deg2rad(angle_deg))
        mine, its = _for_and_against(votes, rolled(votes.local, roll), front)
        margin = (mine - its) / max(mine + its, 1)
        if margin < lowest or (margin == lowest and mine + its > best[1] + best[2]):
            lowest, best = margin, (float(np.arctan2(np.sin(roll), np.cos(roll))), mine, its)
    return best


def mirror_image(votes: Votes, front: FrontMap) -> tuple[int, int]:
    """How many speak for the port as it is, and for its mirror image (x reversed)."""
    return _for_and_against(votes, votes.local * _MIRRORED, front)


def differs_mirrored(front: FrontMap) -> bool:
    """Whether a port is not its own mirror image."""
    i, j, local = cell_points(front.low, front.highest)
    differs = np.zeros(front.highest.shape, dtype=bool)
    differs[i, j] = np.abs(front.misfit(local * _MIRRORED)) > TOLERANCE_M
    return bool(binary_opening(differs, np.ones((2, 2))).sum() * CELL_M**2 > _DIFFERS_M2)  # not how cells fall


def _for_and_against(votes: Votes, seen_from_rival: Array, front: FrontMap) -> tuple[int, int]:
    other = front.misfit(seen_from_rival)
    known = ~np.isnan(other)
    rival = known & (np.abs(other) < votes.tolerance_m)
    return int((known & votes.agrees & ~rival).sum()), int((rival & ~votes.agrees).sum())
