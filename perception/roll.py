"""Roll of a coarsely aligned round port, by trying: the roll at which the fewest points lie off or beyond a surface.

Seen straight on, a round port is all flats: every roll fits them, and only where they end (contacts, wells, key) tells.
An alignment that descends from a few degrees off may stop halfway, so the rolls around it are compared outright.
"""

from __future__ import annotations

import numpy as np

from perception.geometry import Array, Pose
from perception.matching import Measured, match
from perception.port_model import PortModel

_OFFSETS_RAD = np.deg2rad([-4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0])
_CAP_M = 0.0015
_POINTS = 2500


def settle_roll(start: Pose, measured: Measured, model: PortModel, threads: int) -> Pose:
    """``start`` (T_prior_port) rolled to where the cost is least, between the tried rolls by a parabola."""
    some = measured.every(max(1, len(measured.points) // _POINTS))
    poses = [start @ Pose.from_rotvec([0.0, 0.0, offset]) for offset in _OFFSETS_RAD]
    costs = np.array([_cost(pose, some, model, threads) for pose in poses])
    best = int(np.clip(costs.argmin(), 1, len(costs) - 2))
    before, at, after = costs[best - 1 : best + 2]
    curve = before - 2.0 * at + after
    shift = 0.5 * (before - after) / curve if curve > 0 else 0.0
    step = float(_OFFSETS_RAD[1] - _OFFSETS_RAD[0])
    return start @ Pose.from_rotvec([0.0, 0.0, float(_OFFSETS_RAD[best] + np.clip(shift, -1.0, 1.0) * step)])


def _cost(pose: Pose, measured: Measured, model: PortModel, threads: int) -> float:
    """Mean distance of the points from surface or edge, each at most ``_CAP_M``."""
    matches = match(pose, measured, model, threads)
    off: Array = np.minimum(np.hypot(matches.distance, matches.overhang), _CAP_M)
    return float(off.sum() + _CAP_M * (len(measured.points) - len(off))) / max(len(measured.points), 1)
