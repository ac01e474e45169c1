"""What a scan says about where a port's flats end: places in its x-y plane that are on a level, or off it.

A point on a flat must lie within the flat's edge; where a ray passed a level and ended deeper, the level is not there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.flats import Flats
from perception.geometry import Array, Pose
from perception.matching import Measured

_FACING = 0.9
_THROUGH_M = 0.001
"""A ray passed through a flat when its point lies this much deeper."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelPlaces:
    """Places in the port's x-y plane, each with a level that it must be on (sign +1) or off (-1)."""

    xy: Array
    level: NDArray[np.int64]
    sign: Array

    def only(self, these: NDArray[np.bool_]) -> LevelPlaces:
        """Those that a mask (N,) keeps."""
        return LevelPlaces(self.xy[these], self.level[these], self.sign[these])

    def every(self, count: int) -> LevelPlaces:
        """Some ``count`` of them, evenly."""
        step = max(1, len(self.xy) // count)
        return LevelPlaces(self.xy[::step], self.level[::step], self.sign[::step])


def level_places(pose: Pose, measured: Measured, flats: Flats, scale_m: float) -> LevelPlaces:
    """Points on flats, and where rays passed the levels above the flat that they ended on."""
    inverse = pose.inverse()
    if len(flats.heights) == 0:
        return LevelPlaces(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0))
    facing = inverse.rotate(measured.normals)[:, 2] > _FACING
    local = inverse.apply(measured.points[facing])
    sight = inverse.apply(measured.origins[facing]) - local
    away = np.abs(local[:, 2:] - flats.heights)
    level = away.argmin(axis=1)
    on = away.min(axis=1) < 3 * scale_m
    local, sight, level = local[on], sight[on], level[on]
    rows = [LevelPlaces(local[:, :2], level, np.ones(len(local)))]
    for k, height in enumerate(flats.heights):
        deeper = local[:, 2] < height - max(_THROUGH_M, 4 * scale_m)
        share = (height - local[deeper, 2]) / sight[deeper, 2]
        xy = local[deeper, :2] + share[:, None] * sight[deeper, :2]
        rows.append(LevelPlaces(xy, np.full(len(xy), k), np.full(len(xy), -1.0)))
    xy, level, sign = (np.concatenate([getattr(row, name) for row in rows]) for name in LevelPlaces.__slots__)
    return LevelPlaces(xy, level, sign)
