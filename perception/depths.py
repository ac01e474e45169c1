"""Whether a port's flats lie as deep as the model has them, each against the others.

A model that is right in plan and wrong in depth fits on the flats that outvote the rest; those that disagree are
outliers to a robust registration, which is then sure of a pose that is off by their disagreement. A flat that is seen
widely, evenly, and elsewhere than the pose has it refutes one of the two.
"""

from __future__ import annotations

import numpy as np

from perception.flats import FLOOR_M, Flats
from perception.geometry import Array, Pose
from perception.matching import Measured

_FACING = 0.9
_WITHIN_M = 0.0005
"""A point belongs to a flat if it lies so far within its edge."""
_REACH_M = 0.004
"""And no farther than this from its height."""
_CELL_M = 0.0015
_LEAST_CELLS = 30
"""Some 0.7 cm2 of a flat must be seen: tips of contacts tell nothing."""
_EVEN_M = 0.00025
_EVEN_SHARE = 0.6
"""So many of its points lie within three sigmas and this of their median, or it is no flat that is seen there."""


def depth_dispute(pose: Pose, measured: Measured, flats: Flats, scale_m: float) -> float:
    """By how much the flat that disagrees most lies higher than the model has it, metres; 0.0 where none is seen.

    :param pose: T_prior_port.
    :param scale_m: noise of the scan (1 sigma).
    """
    inverse = pose.inverse()
    local = inverse.apply(measured.points[inverse.rotate(measured.normals)[:, 2] > _FACING])
    told = np.flatnonzero(flats.heights > -FLOOR_M)
    disputes = [_offset(local, flats, int(level), scale_m) for level in told]
    return max(disputes, key=abs, default=0.0)


def _offset(local: Array, flats: Flats, level: int, scale_m: float) -> float:
    """How much higher than the model has it one flat is seen; 0.0 if it is not."""
    above = local[:, 2] - flats.heights[level]
    near = np.flatnonzero(np.abs(above) < _REACH_M)
    on = near[flats.beyond(np.full(len(near), level), local[near, :2]) < -_WITHIN_M]
    if len(np.unique(np.floor(local[on, :2] / _CELL_M).astype(np.int64) @ [100_000, 1])) < _LEAST_CELLS:
        return 0.0
    middle = float(np.median(above[on]))
    even = np.mean(np.abs(above[on] - middle) < _EVEN_M + 3.0 * scale_m)
    return middle if even >= _EVEN_SHARE else 0.0
