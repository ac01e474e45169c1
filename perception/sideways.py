"""Place across the axis and roll of a coarsely aligned port, by trying: where the fewest points contradict its edges.

Seen straight on, a port is all flats: every place and roll fits them, and only where they end (contacts, wells, key)
tells. Height and tilt hold still here, so each point keeps its level and moves in the plane: a table look-up says
whether it lies on a flat beyond its edge, or its ray passed through one. The rolls are compared outright, since an
alignment that descends from a few degrees off may stop halfway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.flats import Flats
from perception.geometry import Array, Pose
from perception.level_places import LevelPlaces, level_places
from perception.matching import Measured
from perception.port_model import PortModel

_PASSES = (
    (np.deg2rad(np.arange(-16.0, 16.1, 2.0)), 0.0020, 0.0010, 6, 1200),
    (np.deg2rad(np.arange(-1.5, 1.51, 0.5)), 0.0010, 0.0003, 5, 2500),
)
"""(rolls around the best so far, cap, softness, steps, points) of each pass. A point further on the wrong side than the
cap is something else, and says no more than one at that distance."""
TELLS_SIGMAS = 5.0
"""Levels nearer to each other than so many standard deviations are one level."""
_STRIDE_M = 0.001
_STILL_M = 0.000002
"""A descent that moves by less has arrived."""
_NEAR_M = 0.0025
_VALLEY = 0.1
"""How far up the slopes around the least cost are taken, as a share of their height."""


def settle_sideways(start: Pose, measured: Measured, model: PortModel, scale_m: float) -> Pose:
    """``start`` (T_prior_port) moved across its axis and rolled to where the least contradicts its edges.

    :param scale_m: noise of the scan (1 sigma), which says how far off a level a point on it may lie.
    """
    flats = model.lenient_flats.merged(TELLS_SIGMAS * scale_m)
    places = level_places(start, measured, flats, scale_m)
    if len(places.xy) < 50:
        return start
    at = np.zeros(3)
    for k in range(len(_PASSES)):
        offsets, cap_m, soft_m, steps, points = _PASSES[k]
        some = (places if k == 0 else _near_edges(places, flats, at)).every(points)
        at = _best(some, flats, at, offsets, _Descent(cap_m, soft_m, steps))
    return start @ Pose.from_rotvec([0.0, 0.0, at[2]], [at[0], at[1], 0.0])


def _near_edges(places: LevelPlaces, flats: Flats, at: Array) -> LevelPlaces:
    """Those that an edge is in reach of, from ``at``: the others say nothing about small moves."""
    near = np.abs(flats.beyond(places.level, _seen_from(places, at))) < _NEAR_M
    return places.only(near)


def _seen_from(places: LevelPlaces, at: Array) -> Array:
    """The places (N, 2) in the frame of a port moved by (x, y, roll)."""
    c, s = np.cos(at[2]), np.sin(at[2])
    return np.asarray((places.xy - at[:2]) @ np.array([[c, -s], [s, c]]))


@dataclass(frozen=True, slots=True)
class _Descent:
    cap_m: float
    soft_m: float
    """Wrong by more than this counts by its amount, by less by its square."""
    steps: int


def _best(places: LevelPlaces, flats: Flats, start: Array, offsets: Array, how: _Descent) -> Array:
    """The best (x, y, roll) among rolls ``offsets`` around ``start``, each moved to its best place."""
    found = [_moved(places, flats, start + np.array([0.0, 0.0, offset]), how) for offset in offsets]
    costs = np.array([cost for cost, _ in found])
    at = found[int(costs.argmin())][1].copy()
    at[2] = start[2] + _middle_of_valley(offsets, costs)
    return at


def _middle_of_valley(offsets: Array, costs: Array) -> float:
    """The offset halfway between the two slopes around the least cost; between two edges nothing tells rolls apart."""
    best = int(costs.argmin())
    level = costs[best] + _VALLEY * (costs.max() - costs[best])
    high = np.flatnonzero(costs > level)
    left, right = high[high < best], high[high > best]
    if len(left) == 0 or len(right) == 0:
        return float(offsets[best])
    ends = [
        np.interp(level, [costs[inner], costs[outer]], [offsets[inner], offsets[outer]])
        for outer, inner in ((left[-1], left[-1] + 1), (right[0], right[0] - 1))
    ]
    return float(np.mean(ends))


def _moved(places: LevelPlaces, flats: Flats, at: Array, how: _Descent) -> tuple[float, Array]:
    """(cost, place) after a few steps across the axis, at the roll ``at[2]``."""
    best, where = np.inf, at
    for step in range(how.steps + 1):
        around = flats.around(places.level, _seen_from(places, at))
        distance = around.beyond()
        wrong = np.nan_to_num(np.maximum(distance * places.sign, 0.0))
        cost = float(np.minimum(wrong, how.cap_m).sum())
        if cost < best:
            best, where = cost, at
        if step == how.steps:
            break
        pulls = np.flatnonzero((wrong > 0) & (wrong < how.cap_m))
        weight = 1.0 / np.maximum(wrong[pulls], how.soft_m)
        g = around.outward(pulls)
        normal = (g * weight[:, None]).T @ g + np.eye(2) * 1e-3 * (weight.sum() + 1.0)
        shift = np.linalg.solve(normal, (g * (weight * distance[pulls])[:, None]).sum(axis=0))
        if np.abs(shift).max() < _STILL_M:
            break
        shift *= min(1.0, _STRIDE_M / max(float(np.linalg.norm(shift)), 1e-12))
        c, s = np.cos(at[2]), np.sin(at[2])
        at = at + np.array([c * shift[0] - s * shift[1], s * shift[0] + c * shift[1], 0.0])
    return best, where
