"""The port as a signed volume: how much a scan point at a place speaks for or against the port there.

Positive on visible surface (large flats count less, since panels and pocket floors imitate them), negative inside
solid material, where no ray can end, and slightly negative in the space in front of the surface, which is free but may
hold an occluder. Outside the port's silhouette it is zero: there the car may look as it likes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from perception.geometry import Array, Pose
from perception.surface import Surface

Volume = NDArray[np.float32]

CELL_M = 0.0025
ROLL_STEP_RAD = float(np.deg2rad(4.0))
_SMALL_FLAT_M2 = 3e-4
_SOLID = -0.7
_FREE = -0.3


def flat_weights(surface: Surface) -> Array:
    """Weights (M,) of the samples, 0 to 1: small for large areas at one height that face along the axis."""
    facing = surface.normals[:, 2] > 0.95
    level = np.round(surface.points[:, 2] / 0.001).astype(np.int64)
    level -= level.min()
    area = np.bincount(level[facing], surface.area_m2[facing], minlength=int(level.max()) + 1)[level]
    weight = np.where(facing, np.minimum(1.0, np.sqrt(_SMALL_FLAT_M2 / np.maximum(area, 1e-9))), 1.0)
    return np.asarray(weight * np.sqrt(surface.visibility))


def signed_volume(points: Array, weights: Array, low: Array, shape: tuple[int, int, int], cell_m: float) -> Volume:
    """The volume (shape) whose first cell starts at ``low``, from surface samples (M, 3) with their weights (M,)."""
    cell = np.floor((points - low) / cell_m).astype(np.int64)
    inside = ((cell >= 0) & (cell < shape)).all(axis=1)
    cell, weights, points = cell[inside], weights[inside], points[inside]
    flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    best = np.zeros(int(np.prod(shape)), dtype=np.float32)
    np.maximum.at(best, flat, weights.astype(np.float32))
    volume = best.reshape(shape)
    top = np.full((shape[0], shape[1]), -np.inf)
    np.maximum.at(top, (cell[:, 0], cell[:, 1]), points[:, 2])
    known = np.isfinite(top)
    lowest = minimum_filter(np.where(known, top, np.inf), 3)
    highest = maximum_filter(top, 3)
    z = low[2] + (np.arange(shape[2]) + 0.5) * cell_m
    empty = (volume == 0) & known[:, :, None]
    volume[empty & (z < (lowest - cell_m)[:, :, None])] = _SOLID
    volume[empty & (z > (highest + cell_m)[:, :, None])] = _FREE
    return volume


@dataclass(frozen=True, slots=True, eq=False)
class Templates:
    """Signed volumes of a port at several rolls, all in one box."""

    rolls: Array
    """(R,) radians."""
    low: Array
    """(3,) corner of the box."""
    volumes: Volume
    """(R, X, Y, Z)."""


def build_templates(surface: Surface, roll_rad: float) -> Templates:
    """The volumes for rolls from ``-roll_rad`` to ``roll_rad``, at most ``ROLL_STEP_RAD`` apart."""
    count = int(np.ceil(roll_rad / ROLL_STEP_RAD - 1e-9))
    rolls = np.linspace(-roll_rad, roll_rad, 2 * count + 1)
    weights = flat_weights(surface)
    turned = [surface.points @ Pose.from_rotvec([0.0, 0.0, roll]).rotation.T for roll in rolls]
    low = np.min([points.min(axis=0) for points in turned], axis=0) - CELL_M
    high = np.max([points.max(axis=0) for points in turned], axis=0) + 4 * CELL_M
    x, y, z = (int(n) for n in np.ceil((high - low) / CELL_M))
    volumes = np.stack([signed_volume(points, weights, low, (x, y, z), CELL_M) for points in turned])
    return Templates(rolls, low, volumes)
