"""Whether a scan has the port's proportions: sheared, stretched or leaning, it was not taken as its poses say.

A hand-eye rotation that is off by a degree shears every sweep by about as much, a wrong speed of the sweep stretches
it. Robust registration finds a place for such a scan all the same, on the port that is left when the edges that do not
fit are outliers, and is sure of it. So the edges of the port's flats are fitted once more, with a motion in the plane
that may distort: whether that takes away what contradicts the pose tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.flats import Flats
from perception.geometry import Array, Pose
from perception.level_places import LevelPlaces, level_places
from perception.matching import Measured
from perception.port_model import PortModel
from perception.sideways import TELLS_SIGMAS

_NEAR_M = 0.004
_CAPS_M = (0.003, 0.0015, 0.0008)
"""Places further on the wrong side of an edge belong to something else; with better knowledge fewer are in doubt."""
_STEPS = 4
_SOFT_M = 0.0001
"""Wrong by more than this counts by its amount, by less by its square; taken for 1 sigma of where an edge seems."""
_PLACES = 8_000
_LEAST_PLACES = 200
_SIGMA = np.array([0.002, 0.002, 0.05, 0.05, 0.05, 0.03, 0.10, 0.10])
"""What the motion may be (1 sigma): x, y (m), roll, two ways to distort without a change of size, size, two to lean."""
_IN_DOUBT_M = 3e-7
"""A contradiction of so much for each place is nothing that asks for an explanation."""


@dataclass(frozen=True, slots=True)
class Distortion:
    """How a scan's proportions differ from the port's, in the port's frame."""

    shear_rad: float = 0.0
    """How far what should be a right angle between x and y is from one."""
    stretch_x: float = 0.0
    """Share by which the scan is too long along x."""
    stretch_y: float = 0.0
    lean_rad: float = 0.0
    """How far what lies deep is displaced sideways against what lies high, as an angle."""
    explains: float = 0.0
    """Share of what contradicts the undistorted pose that these take away."""


UNDISTORTED = Distortion()


def distortion(pose: Pose, measured: Measured, model: PortModel, scale_m: float) -> Distortion:
    """The distortion of a scan around its pose T_prior_port; all 0 where its edges do not tell.

    :param scale_m: noise of the scan (1 sigma).
    """
    flats = model.flats.merged(TELLS_SIGMAS * scale_m)
    places = level_places(pose, measured, flats, scale_m)
    places = places.only(np.abs(flats.beyond(places.level, places.xy)) < _NEAR_M).every(_PLACES)
    if len(places.xy) < _LEAST_PLACES:
        return UNDISTORTED
    motion = _fitted(places, flats)
    before, after = (_contradiction(places, flats, one) for one in (np.zeros(8), motion))
    differ, shear, size, *lean = motion[3:]
    return Distortion(
        shear_rad=2.0 * float(np.abs(shear)),
        stretch_x=-float(size + differ),
        stretch_y=-float(size - differ),
        lean_rad=float(np.hypot(*lean)),
        explains=(before - after) / (before + _IN_DOUBT_M * len(places.xy)),
    )


def _fitted(places: LevelPlaces, flats: Flats) -> Array:
    """The motion (8,) of the places that contradicts the edges least."""
    motion = np.zeros(8)
    for cap_m in np.repeat(_CAPS_M, _STEPS):
        xy = _moved(places, flats, motion)
        around = flats.around(places.level, xy)
        distance = around.beyond()
        wrong = np.nan_to_num(np.maximum(distance * places.sign, 0.0))
        pulls = np.flatnonzero((wrong > 0) & (wrong < cap_m))
        outward = around.outward(pulls)
        by_x, by_y = _columns(places, flats, pulls)
        jacobian = outward[:, :1] * by_x + outward[:, 1:] * by_y
        weight = 1.0 / (np.maximum(wrong[pulls], _SOFT_M) * _SOFT_M)
        information = (jacobian * weight[:, None]).T @ jacobian + np.diag(_SIGMA**-2)
        gradient = jacobian.T @ (weight * distance[pulls]) + motion * _SIGMA**-2
        motion = motion - np.linalg.solve(information, gradient)
    return motion


def _columns(places: LevelPlaces, flats: Flats, which: NDArray[np.int64] | slice) -> tuple[Array, Array]:
    """(M, 8) each: how the motion's parameters move places along x, and along y."""
    x, y = places.xy[which].T
    depth = (flats.heights - flats.heights.mean())[places.level[which]]
    one, none = np.ones_like(x), np.zeros_like(x)
    by_x = np.column_stack([one, none, -y, x, y, x, depth, none])
    return by_x, np.column_stack([none, one, x, -y, x, y, none, depth])


def _moved(places: LevelPlaces, flats: Flats, motion: Array) -> Array:
    by_x, by_y = _columns(places, flats, slice(None))
    return np.asarray(places.xy + np.column_stack([by_x @ motion, by_y @ motion]))


def _contradiction(places: LevelPlaces, flats: Flats, motion: Array) -> float:
    """How far places lie on the wrong side of their edges, in all."""
    distance = flats.beyond(places.level, _moved(places, flats, motion))
    return float(np.minimum(np.nan_to_num(np.maximum(distance * places.sign, 0.0)), _CAPS_M[-1]).sum())
