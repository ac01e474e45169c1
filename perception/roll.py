"""Roll of a coarsely aligned round port, by trying: the roll at which the fewest points lie off or beyond a surface.

Seen straight on, a round port is all flats: every roll fits them, and only where they end (contacts, wells, key) tells.
An alignment that descends from a few degrees off may stop halfway, so the rolls around it are compared outright.
"""

from __future__ import annotations

import numpy as np

from perception.geometry import Array, Pose
from perception.matching import Measured, match
from perception.port_model import PortModel

_COARSE_RAD = np.deg2rad([-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0])
_FINE_RAD = np.deg2rad(np.arange(-3.0, 3.01, 0.75))
_CAP_M = 0.0015
_POINTS = 2000


def settle_roll(start: Pose, measured: Measured, model: PortModel, threads: int) -> Pose:
    """``start`` (T_prior_port) rolled to where the cost is least."""
    some = measured.every(max(1, len(measured.points) // _POINTS))
    for offsets in (_COARSE_RAD, _FINE_RAD):
        costs = np.array([_cost(_rolled(start, offset), some, model, threads) for offset in offsets])
        start = _rolled(start, _least(offsets, costs))
    return start


def _rolled(pose: Pose, offset_rad: float) -> Pose:
    return pose @ Pose.from_rotvec([0.0, 0.0, offset_rad])


def _least(offsets: Array, costs: Array) -> float:
    """Where the cost is least: the best offset, moved to the vertex of the parabola through it and its neighbours."""
    best = int(costs.argmin())
    if best in (0, len(costs) - 1):
        return float(offsets[best])
    before, at, after = costs[best - 1 : best + 2]
    curve = before - 2.0 * at + after
    shift = 0.5 * (before - after) / curve if curve > 0 else 0.0
    return float(offsets[best] + shift * (offsets[1] - offsets[0]))


def _cost(pose: Pose, measured: Measured, model: PortModel, threads: int) -> float:
    """Mean distance of the points from surface or edge, each at most ``_CAP_M``."""
    matches = match(pose, measured, model, threads)
    off: Array = np.minimum(np.hypot(matches.distance, matches.overhang), _CAP_M)
    return float(off.sum() + _CAP_M * (len(measured.points) - len(off))) / max(len(measured.points), 1)
