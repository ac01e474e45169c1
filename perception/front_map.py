"""The port as a map of heights seen from the front, for evidence that is local: which place should be how deep.

Large surfaces fit many poses; what tells a port from a cap, another type or itself rolled by a quarter turn are places
of a few square millimetres: contacts, wells, key and latch side. The map knows for each cell the range of heights that
a point there may have, how much the cell tells a pose from rolled ones, and which contact-sized feature it belongs to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    binary_fill_holes,
    label,
    maximum,
    maximum_filter,
    minimum_filter,
)

from perception.flats import FLOOR_M, near_any
from perception.geometry import Array

CELL_M = 0.0005
TOLERANCE_M = 0.001
_CORE_CELLS = 14
_FEATURE_AREA_M2 = (4e-6, 4e-4)
_ANY_DEPTH_M = 0.2
_ROLLS_RAD = np.deg2rad(np.arange(12.0, 349.0, 12.0))

Map = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class FrontMap:
    """Cells of ``CELL_M`` in the port's x-y plane; all maps (X, Y)."""

    low: Array
    """(2,) corner of the first cell."""
    lowest: Map
    """Least height of the surface in a cell and its neighbours, NaN outside the port's outline."""
    highest: Map
    """Greatest height there."""
    distinct: Map
    """0 where any roll would show the same height, to 1 where every other roll shows another one."""
    feature: NDArray[np.int16]
    """Number of the contact-sized feature, 0 for none; negative for bores, of which only the emptiness is seen."""
    inner: NDArray[np.bool_]
    """Whether the cell is well within the rim: where a plug goes."""

    @property
    def features(self) -> int:
        """How many contact-sized features with a surface there are."""
        return max(int(self.feature.max()), 0)

    @property
    def reachable(self) -> NDArray[np.bool_]:
        """Which of them (F,) no depth hides from a laser."""
        heights = maximum(np.nan_to_num(self.highest, nan=-np.inf), self.feature, range(1, self.features + 1))
        return np.asarray(np.asarray(heights) > -FLOOR_M)

    @property
    def bores(self) -> int:
        """How many contact-sized bores there are."""
        return max(-int(self.feature.min()), 0)

    def without(self, heights_m: Sequence[float]) -> FrontMap:
        """The same, where flats at these heights around the rim belong to the port no more than the vehicle does."""
        known = np.isfinite(self.highest)
        around = known & ~_enclosed(known & (self.highest > -TOLERANCE_M))
        silent = np.zeros_like(around)
        silent[around] = near_any(self.highest[around], heights_m) | near_any(self.lowest[around], heights_m)
        lowest, highest = (np.where(silent, np.float32(np.nan), heights) for heights in (self.lowest, self.highest))
        return replace(self, lowest=lowest, highest=highest)

    def cells(self, local: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Cell numbers of points (N, 2 or 3) and which of them lie in the port's outline."""
        at = np.floor((local[:, :2] - self.low) / CELL_M).astype(np.int64)
        shape = np.array(self.lowest.shape)
        inside = ((at >= 0) & (at < shape)).all(axis=1)
        at = np.clip(at, 0, shape - 1)
        inside &= np.isfinite(self.lowest[at[:, 0], at[:, 1]])
        return at[:, 0], at[:, 1], inside

    def misfit(self, local: Array) -> Array:
        """How far points (N, 3) are before (+) or behind (-) where the port may be; NaN outside its outline."""
        i, j, inside = self.cells(local)
        z = local[:, 2]
        before, behind = np.maximum(z - self.highest[i, j], 0.0), np.minimum(z - self.lowest[i, j], 0.0)
        return np.where(inside, before + behind, np.nan)


def build_front_map(points: Array) -> FrontMap:
    """The map of a visible surface, given as samples (N, 3) denser than a cell."""
    low = points[:, :2].min(axis=0) - 2 * CELL_M
    at = np.floor((points[:, :2] - low) / CELL_M).astype(np.int64)
    shape = at.max(axis=0) + 3
    top = np.full(shape, -np.inf)
    np.maximum.at(top, (at[:, 0], at[:, 1]), points[:, 2])
    filled = np.where(np.isfinite(top), top, maximum_filter(top, 3))  # a cell that no sample met
    bores = _bores(filled)
    filled = np.where(bores > 0, _walls_end(filled, bores), filled)
    known = np.isfinite(filled)
    highest = maximum_filter(filled, 3)
    lowest = minimum_filter(np.where(known, filled, np.inf), 3)
    lowest[bores > 0] = -_ANY_DEPTH_M
    known &= binary_erosion(known, np.ones((3, 3)))
    lowest, highest = np.where(known, lowest, np.nan), np.where(known, highest, np.nan)
    plain = FrontMap(
        low,
        lowest.astype(np.float32),
        highest.astype(np.float32),
        np.zeros(shape, np.float32),
        np.zeros(shape, np.int16),
        np.zeros(shape, np.bool_),
    )
    middle = np.where(known, filled, np.nan)
    rim = known & (filled > -TOLERANCE_M)
    inner = binary_erosion(np.pad(_enclosed(rim), 1), iterations=_CORE_CELLS)[1:-1, 1:-1] & known
    features = _features(np.where(bores > 0, np.nan, middle))
    features = np.where(bores > 0, -bores, features).astype(np.int16)
    return FrontMap(low, plain.lowest, plain.highest, _distinct(plain, middle), features, inner)


def _bores(height: Array) -> NDArray[np.int64]:
    """Numbers of the contact-sized holes within the rim whose floor no scanner sees; 0 elsewhere.

    The flange's holes are none: they have screws in them, or not.
    """
    known = np.isfinite(height)
    within = _enclosed(known & (height > -TOLERANCE_M))
    patches, found = label(binary_fill_holes(known) & ~known & within)
    areas = np.bincount(patches.reshape(-1), minlength=found + 1) * CELL_M**2
    wide = np.zeros(found + 1, np.int64)
    count = 0
    for k in range(1, found + 1):
        if _FEATURE_AREA_M2[0] < areas[k] < _FEATURE_AREA_M2[1] and _round(patches == k):
            count += 1
            wide[k] = count
    return np.asarray(wide[patches])


def _round(patch: NDArray[np.bool_]) -> bool:
    """Whether a patch fills its bounding box as a circle or a square does, not as a slit or a sickle."""
    i, j = np.nonzero(patch)
    sides = np.array([np.ptp(i) + 1, np.ptp(j) + 1])
    return bool(sides.max() < 1.5 * sides.min() and patch.sum() > 0.6 * sides.prod())


def _walls_end(height: Array, bores: NDArray[np.int64]) -> Array:
    """For each bore the lowest height that is seen of its walls: nothing in it is higher than that. (X, Y)."""
    ends = np.full(height.shape, np.nan)
    for k in range(1, int(bores.max()) + 1):
        around = binary_dilation(bores == k, iterations=2) & np.isfinite(height)
        ends[bores == k] = height[around].min() - 2 * TOLERANCE_M
    return ends


def _enclosed(rim: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells with rim on at least three of their four sides, or under them: a rim may have a gap for a latch."""
    left, right = np.maximum.accumulate(rim, 0), np.maximum.accumulate(rim[::-1], 0)[::-1]
    below, above = np.maximum.accumulate(rim, 1), np.maximum.accumulate(rim[:, ::-1], 1)[:, ::-1]
    sides = left.astype(np.int64) + right + below + above
    return np.asarray(rim | (sides >= 3))


def _distinct(plain: FrontMap, height: Array) -> Map:
    i, j, local = cell_points(plain.low, height)
    share = np.zeros(len(local))
    for roll in _ROLLS_RAD:
        misfit = np.abs(plain.misfit(rolled(local, roll)))
        share += np.where(np.isnan(misfit), 0.0, misfit > TOLERANCE_M)
    distinct = np.zeros(height.shape, np.float32)
    distinct[i, j] = share / len(_ROLLS_RAD)
    return distinct


def cell_points(low: Array, height: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Cells (N,), (N,) of a map with a height, and the points (N, 3) in their middles; ``low``: the map's corner."""
    i, j = np.nonzero(np.isfinite(height))
    return i, j, np.column_stack([low + (np.column_stack([i, j]) + 0.5) * CELL_M, height[i, j]])


def rolled(local: Array, roll_rad: float) -> Array:
    """Points (N, 3) of the port frame as seen from a port that is rolled by ``roll_rad``."""
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.column_stack([c * local[:, 0] + s * local[:, 1], -s * local[:, 0] + c * local[:, 1], local[:, 2]])


def _features(height: Array) -> NDArray[np.int16]:
    """Connected patches of one height that have the size of a contact, a well or a key."""
    step = np.round(np.nan_to_num(height, nan=9.0) / TOLERANCE_M).astype(np.int64)
    feature = np.zeros(height.shape, np.int16)
    count = 0
    for level in np.unique(step[np.isfinite(height)]):
        patches, found = label(step == level)
        areas = np.bincount(patches.reshape(-1), minlength=found + 1) * CELL_M**2
        for k in range(1, found + 1):
            if _FEATURE_AREA_M2[0] < areas[k] < _FEATURE_AREA_M2[1]:
                core = binary_erosion(patches == k, np.ones((3, 3)))
                if core.sum() * CELL_M**2 > 1e-6:
                    count += 1
                    feature[core] = count
    return feature
