"""What stands where no inlet is seen: the vehicle's closed skin, with the groove of a closed charging cover or without.

Looked at only where the port was refused: a dock in front of a closed cover needs another remedy than one at the wrong
place. The groove around a closed cover is narrow, and its far side and floor are seen from few directions: it is known
by the missing skin, a closed line around the place, and not by its depth.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from perception.estimate import Prior
from perception.geometry import Array

Flags = NDArray[np.bool_]
Skin = Literal["closed-cover", "no-port"]

SKIN_REASONS: dict[Skin, str] = {
    "closed-cover": "the vehicle's skin is closed here, with a groove around: a closed charging cover",
    "no-port": "the vehicle's skin is closed here, and nothing opens in it",
}

_REACH_M = 0.16
_BEFORE_M, _BEHIND_M = 0.09, -0.09
"""Over and under the place where the port was expected."""
_SKIN_M = (0.0012, 0.0035)
"""The skin's points lie within this of a smooth sheet: the least, and the most for scans of much noise."""
_SPREADS = 3.5
_GATES_M = (0.02, 0.008, 0.004, 0.0025)
_FEWEST = 400
_CELL_M = 0.0015
_CLOSED_SHARE = 0.85
"""Of what was seen within ``_INLET_M`` of the middle lies on the skin, if nothing opens there."""
_INLET_M = 0.03
_GROOVE_M = 0.008
"""A gap in the skin narrower than this is a groove."""
_LONG_M = 0.02
"""Shorter gaps are noise."""
_RING_M = (0.022, 0.14)
_SECTORS = 48
_RING_SHARE, _CLEAN_RING_SHARE, _NO_RING_SHARE = 0.62, 0.42, 0.35
"""So much of a ring is a cover; so much is one on skin that hardly anything disturbs; so little is none."""
_CLEAN_SHARE = 0.93
_OPPOSITE_SHARE = 0.2
"""Directions in which the groove is seen on both sides of the middle: a corner of two body gaps has none."""
_STEADY_M = 0.012
"""How far the groove may run in or out from one sector to the next."""


def closed_panel(points: Array, prior: Prior) -> Skin | None:
    """A closed cover, plain skin, or None where neither is shown.

    :param points: (N, 3) of the scan, in the prior's reference frame.
    """
    local = prior.T_ref_port.inverse().apply(points)
    near = (np.abs(local[:, :2]) < _REACH_M).all(axis=1) & (local[:, 2] > _BEHIND_M) & (local[:, 2] < _BEFORE_M)
    local = local[near]
    if len(local) < _FEWEST:
        return None
    off_skin = _off_the_skin(local)
    if off_skin is None:
        return None
    on_skin = np.abs(off_skin) < 1.0
    middle = np.hypot(local[:, 0], local[:, 1]) < _INLET_M + prior.lateral_m
    closed = float(on_skin[middle].mean()) if middle.sum() >= _FEWEST else 0.0
    if closed < _CLOSED_SHARE:
        return None
    ring = _ring_share(local[:, :2], off_skin)
    if ring >= (_RING_SHARE if closed < _CLEAN_SHARE else _CLEAN_RING_SHARE):
        return "closed-cover"
    return "no-port" if ring < _NO_RING_SHARE else None


def _off_the_skin(points: Array) -> Array | None:
    """How far points (N, 3) are off the smooth sheet that most of them lie on; None without such a sheet.

    :returns: (N,), above 0 towards the scanner, as a multiple of the most that noise explains: the skin is within 1.
    """
    x, y, z = (points / _REACH_M).T
    terms = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    height = points[:, 2] - np.median(points[:, 2])
    for gate in _GATES_M:
        near = np.abs(height) < gate
        if near.sum() < _FEWEST:
            return None
        height = points[:, 2] - _REACH_M * terms @ np.linalg.lstsq(terms[near], z[near], rcond=None)[0]
    spread_m = 1.4826 * np.median(np.abs(height[np.abs(height) < _GATES_M[-2]]))
    return np.asarray(height / np.clip(_SPREADS * spread_m, *_SKIN_M))


def _ring_share(places: Array, off_skin: Array) -> float:
    """In what share of all directions a narrow gap of the skin runs around one place, at a steady distance.

    :param places: (N, 2) of all points in the plane that the skin roughly is.
    :param off_skin: (N,) as ``_off_the_skin`` tells.
    """
    gap, low = _gaps(places, off_skin)
    labels, _ = ndimage.label(ndimage.binary_dilation(gap, np.ones((3, 3))), np.ones((3, 3)))
    long = [
        label
        for label, (rows, columns) in enumerate(ndimage.find_objects(labels), start=1)
        if max(rows.stop - rows.start, columns.stop - columns.start) * _CELL_M >= _LONG_M
    ]
    cells = np.argwhere(gap & np.isin(labels, long)) * _CELL_M + low
    return _around(cells) if len(cells) else 0.0


def _gaps(places: Array, off_skin: Array) -> tuple[Flags, Array]:
    """Cells within the skin where it is missing or most points lie under it; and the corner of the first cell."""
    low = places.min(axis=0) - 4 * _CELL_M
    at = np.floor((places - low) / _CELL_M).astype(np.int64)
    size = tuple(at.max(axis=0) + 5)
    on, under = (_counted(at[chosen], size) for chosen in (np.abs(off_skin) < 1.0, off_skin < -1.0))
    filled = ndimage.binary_closing(on > 0, np.ones((2, 2)))
    missing = ndimage.binary_closing(filled, _disc(_GROOVE_M / 2)) & ~filled
    return missing | (under > np.maximum(on, 0)), low


def _counted(at: NDArray[np.int64], size: tuple[int, ...]) -> NDArray[np.int64]:
    """How many points lie in each cell."""
    return np.bincount(np.ravel_multi_index(tuple(at.T), size), minlength=int(np.prod(size))).reshape(size)


def _disc(radius_m: float) -> Flags:
    n = int(np.ceil(radius_m / _CELL_M))
    x, y = np.ogrid[-n : n + 1, -n : n + 1]
    return np.asarray(np.hypot(x, y) * _CELL_M <= radius_m + 1e-9)


def _around(cells: Array) -> float:
    """Share of the directions from the middle of ``cells`` (M, 2) in which some lie, at a steady distance; 0 where
    they lie on one side only.
    """
    middle = (cells.min(axis=0) + cells.max(axis=0)) / 2
    offset = cells - middle
    radius, turn = np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi)
    inside, sector = (radius > _RING_M[0]) & (radius < _RING_M[1]), np.floor(turn * _SECTORS).astype(int) % _SECTORS
    found = np.full(_SECTORS, np.nan)
    for k in range(_SECTORS):
        here = radius[inside & (sector == k)]
        if len(here):
            found[k] = np.median(here)
    steady = np.abs(found - np.roll(found, 1)) < _STEADY_M
    covered = ~np.isnan(found) & (steady | np.roll(steady, -1))
    both = covered & np.roll(ndimage.maximum_filter1d(covered, 3, mode="wrap"), _SECTORS // 2)
    return float(covered.mean()) if both.mean() > _OPPOSITE_SHARE else 0.0
