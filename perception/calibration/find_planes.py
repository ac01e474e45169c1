"""The coarse stage with three planes: which points of each sweep lie on which plane.

A mounting guess that is off shears a sweep's cloud, and a sheared plane is still a plane: each sweep is cut into its
three largest planes, and these are matched with the first sweep's by their directions.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.calibration.errors import CalibrationError
from perception.calibration.sightings import Mounting, Sightings
from perception.calibration.targets import PlanesTarget
from perception.geometry import Array

log = logging.getLogger(__name__)

PLANES = 3
LEAST_SWEEPS = 4
TRIES = 300
THICK_M = 0.001
MIN_SHARE = 0.06
"""Of a sweep's points, on each plane."""
LEAST_ANGLE_RAD = float(np.deg2rad(40.0))
"""Between any two of the planes, and twice what matching may be off by."""
COARSE_SCALE_M = 0.03
"""For the solver's first rounds: a mounting that is 10 deg off displaces points by 50 mm."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundPlanes:
    """Three planes in all sweeps."""

    on_planes: NDArray[np.bool_]
    """(N,) which sightings lie on one of them."""
    target: PlanesTarget
    """For those sightings, as the first sweep shows it."""


def find_planes(seen: Sightings, guess: Mounting, rng: np.random.Generator) -> FoundPlanes:
    """Three planes in the sweeps; a sweep that does not show three that differ enough is left out.

    :raises CalibrationError: what is wrong with the first such sweep, where too few others are left
    """
    points, owner = seen.in_base(guess), seen.sweep_of_point
    plane, used = np.full(len(seen), -1), 0
    known: tuple[Array, Array] | None = None
    problem: CalibrationError | None = None
    for number in np.unique(owner):
        chosen = np.flatnonzero(owner == number)
        try:
            normals, offsets, label = _cut(points[chosen], int(number), rng)
            matched = _matched(normals, normals if known is None else known[0], int(number))
        except CalibrationError as error:
            log.info("left out: %s", error.cause)
            problem = problem or error
            continue
        known, used = known or (normals, offsets), used + 1
        plane[chosen] = np.where(label >= 0, matched[label], -1)
    if known is None or used < LEAST_SWEEPS:
        raise problem or CalibrationError(f"{used} sweeps are too few to calibrate from")
    return FoundPlanes(plane >= 0, PlanesTarget(known[0], known[1], plane[plane >= 0]))


def _cut(points: Array, number: int, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.int64]]:
    """Normals (3, 3) towards +x of the first, offsets (3,), and each point's plane or -1."""
    label = np.full(len(points), -1)
    normals, offsets = np.empty((PLANES, 3)), np.empty(PLANES)
    for k in range(PLANES):
        left = np.flatnonzero(label < 0)
        normals[k], offsets[k] = _largest(points[left], rng)
        near = np.abs(points[left] @ normals[k] - offsets[k]) < THICK_M
        if near.sum() < MIN_SHARE * len(points):
            raise CalibrationError(
                f"sweep {number + 1} shows only {k} planes", remedy="Sweep over the corner, so that all three are seen."
            )
        label[left[near]] = k
    cosines = np.abs(normals @ normals.T)[np.triu_indices(PLANES, 1)]
    if cosines.max() > np.cos(LEAST_ANGLE_RAD):
        raise CalibrationError(
            f"sweep {number + 1} shows planes that are nearly parallel", remedy="Use a corner with right angles."
        )
    return normals, offsets, label


def _largest(points: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """The plane with the most points near it, fitted to them."""
    if len(points) < 3:
        return np.array([0.0, 0.0, 1.0]), np.inf
    corners = points[rng.integers(0, len(points), (TRIES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    offsets = np.einsum("ti,ti->t", normals, corners[lengths > 1e-9, 0])
    sample = points[rng.integers(0, len(points), min(len(points), 2000))]
    counts = (np.abs(sample @ normals.T - offsets) < THICK_M).sum(axis=0)
    best = int(np.argmax(counts))
    inside = points[np.abs(points @ normals[best] - offsets[best]) < THICK_M]
    middle = inside.mean(axis=0)
    normal = np.linalg.svd(inside - middle, full_matrices=False)[2][2]
    return normal, float(normal @ middle)


def _matched(normals: Array, known: Array, number: int) -> NDArray[np.int64]:
    """(3,) which known plane each plane is."""
    cosines = np.abs(normals @ known.T)
    match = cosines.argmax(axis=1)
    if len(set(match.tolist())) < PLANES:
        raise CalibrationError(
            f"the planes of sweep {number + 1} cannot be told apart from those of the first",
            remedy="Start from a mounting that is known to 10 deg, and use a corner with right angles.",
        )
    return np.asarray(match)
