"""The coarse stage with a sphere: where it is in each sweep, and the mounting that brings these places together.

With a mounting guess that is some degrees off, a sweep's cloud is sheared; the sphere in it still has nearly its
radius. Each surface point votes for a centre one radius behind it; the densest place wins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from perception.calibration.errors import CalibrationError
from perception.calibration.sightings import Mounting, Sightings
from perception.calibration.targets import SphereTarget
from perception.geometry import Array, Pose, exp

NEIGHBOURS = 16
VOTE_M = 0.006
"""Votes agree within this: shear and noise of normals."""
MIN_POINTS = 80
"""Of a sweep on the sphere."""
LEAST_CAP_RAD = float(np.deg2rad(35.0))
"""The points must reach this far from the sphere's foremost point in all directions, else it is half hidden."""
SHEAR_M = 0.003
"""1 sigma of a sweep's centre: its cloud is sheared as long as the mounting is a guess."""
GUESS_M, GUESS_RAD = 0.02, float(np.deg2rad(10.0))
"""How good the guess is: this decides only where the sweeps' centres say little, as when all look from one distance."""
GRAZING_RAD = float(np.deg2rad(65.0))
"""Ranges are not used where the surface is steeper than this to the line of sight."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundSphere:
    """The sphere in all sweeps."""

    on_sphere: NDArray[np.bool_]
    """(N,) which sightings lie on it."""
    target: SphereTarget
    mounting: Mounting
    """The guess, improved so far that all sweeps show the sphere at one place."""


def find_sphere(seen: Sightings, radius_m: float, guess: Mounting) -> FoundSphere:
    """The sphere's points in every sweep.

    :raises CalibrationError: a sweep does not show a sphere of this radius, or shows only a part of it
    """
    points, owner = seen.in_base(guess), seen.sweep_of_point
    sweeps = np.unique(owner)
    on_sphere, centres = np.zeros(len(seen), dtype=bool), np.empty((len(sweeps), 3))
    for row, number in enumerate(sweeps):
        chosen = np.flatnonzero(owner == number)
        sight = _line_of_sight(seen, guess, int(number))
        centres[row], inside = _in_sweep(points[chosen], radius_m, sight, int(number))
        on_sphere[chosen[inside]] = True
    mounting, centre = _brought_together(seen, guess, sweeps, centres)
    return FoundSphere(on_sphere, SphereTarget(centre, radius_m), mounting)


def _line_of_sight(seen: Sightings, guess: Mounting, number: int) -> Array:
    """Unit vector (3,) from the scanner into the scene in the middle of a sweep, base frame."""
    middle = np.flatnonzero(seen.sweep == number)
    return np.asarray(seen.rotations[middle[len(middle) // 2]] @ guess.T_flange_scanner.rotation[:, 2])


def _in_sweep(points: Array, radius_m: float, sight: Array, number: int) -> tuple[Array, NDArray[np.bool_]]:
    """Centre (3,) and which of the points (n,) lie on the sphere, in one sweep."""
    if len(points) < MIN_POINTS:
        raise CalibrationError(f"sweep {number + 1} has {len(points)} points: no sphere to see")
    votes = points - radius_m * _towards(points, sight)
    near = cKDTree(votes).query_ball_point(votes, VOTE_M, return_length=True)
    centre = votes[np.linalg.norm(votes - votes[int(np.argmax(near))], axis=1) < VOTE_M].mean(axis=0)
    for tolerance_m in (0.4 * radius_m, 0.25 * radius_m, 0.2 * radius_m):
        inside = np.abs(np.linalg.norm(points - centre, axis=1) - radius_m) < tolerance_m
        inside &= np.linalg.norm(votes - centre, axis=1) < 2.0 * tolerance_m
        if inside.sum() < MIN_POINTS:
            raise CalibrationError(
                f"sweep {number + 1} shows no sphere of {2e3 * radius_m:.1f} mm diameter",
                remedy="Check the sphere's diameter, and that every sweep crosses the whole of it.",
            )
        centre = _fitted(points[inside], centre, radius_m)
    inside &= _steepness(points, centre, sight) < GRAZING_RAD
    _refuse_half(points[inside], centre, sight, number)
    return centre, inside


def _towards(points: Array, sight: Array) -> Array:
    """Unit normals (n, 3) that face the scanner."""
    _, near = cKDTree(points).query(points, k=NEIGHBOURS, workers=2)
    local = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", local, local))[1][:, :, 0]
    return np.asarray(np.where((normals @ sight > 0)[:, None], -normals, normals))


def _fitted(points: Array, centre: Array, radius_m: float) -> Array:
    def off(c: Array) -> Array:
        return np.asarray(np.linalg.norm(points - c, axis=1) - radius_m)

    return np.asarray(least_squares(off, centre, loss="soft_l1", f_scale=0.002).x)


def _steepness(points: Array, centre: Array, sight: Array) -> Array:
    """Angle (n,) between each point's normal and the line back to the scanner."""
    outward = (points - centre) / np.linalg.norm(points - centre, axis=1)[:, None]
    return np.asarray(np.arccos(np.clip(-outward @ sight, -1.0, 1.0)))


def _refuse_half(points: Array, centre: Array, sight: Array, number: int) -> None:
    """The seen cap must reach far enough to all four sides of the line of sight."""
    across = np.linalg.svd(sight[None])[2][1:]
    spokes = (points - centre) @ np.vstack([across, -sight[None]]).T
    for k in range(2):
        angle = np.arctan2(spokes[:, k], spokes[:, 2])
        if np.percentile(angle, 2) > -LEAST_CAP_RAD or np.percentile(angle, 98) < LEAST_CAP_RAD:
            raise CalibrationError(
                f"sweep {number + 1} shows only a part of the sphere",
                remedy="Clear what hides it, or place the sweep so that it crosses the whole sphere.",
            )


def _brought_together(
    seen: Sightings, guess: Mounting, sweeps: NDArray[np.int64], centres: Array
) -> tuple[Mounting, Array]:
    """The mounting that puts the sphere of each sweep at one place (hand-eye calibration with a point)."""
    middles = [np.flatnonzero(seen.sweep == number) for number in sweeps]
    index = np.array([rows[len(rows) // 2] for rows in middles])
    rotations, translations = seen.rotations[index], seen.translations[index]
    in_flange = np.einsum("mji,mj->mi", rotations, centres - translations)
    in_scanner = guess.T_flange_scanner.inverse().apply(in_flange)
    guessed = guess.T_flange_scanner

    def pose(x: Array) -> Pose:
        turned = guessed @ exp([0.0, 0.0, 0.0, *x[3:6]])
        return Pose(turned.rotation, turned.translation + x[:3])

    def off(x: Array) -> Array:
        placed = np.einsum("mij,mj->mi", rotations, pose(x).apply(in_scanner)) + translations - x[6:9]
        return np.concatenate([placed.ravel() / SHEAR_M, x[:3] / GUESS_M, x[3:6] / GUESS_RAD])

    solved = least_squares(off, np.concatenate([np.zeros(6), centres.mean(axis=0)]), loss="soft_l1").x
    return Mounting(pose(solved), guess.time_offset_s, guess.speed_scale), np.asarray(solved[6:9])
