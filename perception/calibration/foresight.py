"""What a sweep that has not been made yet would add: the poses of a calibration are chosen by it.

A candidate's sweep of a target is foreseen without noise; sweeps are then taken up one by one, each time the one after
which the mounting is least uncertain (greedy design of experiments).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.calibration.hand_eye import Asked, mounting_jacobian
from perception.calibration.sightings import Mounting, Sightings
from perception.calibration.skins import Skin
from perception.calibration.targets import Distances
from perception.calibration.uncertainty import coupling, sandwich
from perception.geometry import Array, Pose

PROFILES = 90
RAYS = 90
HALF_FAN = 0.28
"""Tangent of half the laser fan's angle."""
MOST = 600
"""Points of one sweep, thinned: the solver takes no more of it."""


KNOWN_M, KNOWN_RAD = 0.02, float(np.deg2rad(10.0))
"""How well the mounting is known before the first sweep."""


@dataclass(frozen=True, slots=True)
class Expected:
    """How good the cell is taken to be while it is planned."""

    noise_m: float = 1e-4
    """1 sigma of a range."""
    shift_m: float = 5e-5
    """1 sigma of what the arm is off, each axis, from sweep to sweep."""
    thinning: float = 0.1
    """Points foreseen over points measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """What one sweep says."""

    normal: Array
    """(K, K)."""
    pull: Array
    """(K, K) what ranges with unit noise pull at the solution: less where the ray grazes the target."""
    coupling: Array
    """(K, 3)."""
    points: int
    """So many rays meet the target, were all its parts met as the least: few mean that the sweep would miss one."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A straight sweep at constant speed."""

    T_base_flange_start: Pose
    T_base_flange_end: Pose
    duration_s: float


def foreseen(sweep: Sweep, skin: Skin, mounting: Mounting, asked: Asked) -> Foreseen:
    """What a sweep of a target would add, as many points counted as ``PROFILES`` of ``RAYS`` meet, at most ``MOST``."""
    seen, met, steep, rays = _sightings(sweep, skin, mounting)
    rays = rays * min(1.0, MOST / max(1.0, rays.sum()))
    distances = Distances(np.zeros(len(seen)), skin.normals[met], skin.own[met])
    jacobian = np.column_stack([mounting_jacobian(seen, mounting, distances)[:, asked.columns], distances.own])
    normal, pull = ((jacobian * (rays * weight)[:, None]).T @ jacobian for weight in (1.0, steep**2))
    parts = int(skin.part.max()) + 1
    least = np.bincount(skin.part[met], rays, minlength=parts).min()
    return Foreseen(normal, pull, coupling(jacobian, rays, distances.gradient), int(parts * least))


def covariance_after(sweeps: Sequence[Foreseen], expected: Expected) -> Array:
    """(6, 6) of the mounting's pose after all these sweeps, what is known beforehand counted in."""
    normal = sum((one.normal for one in sweeps), np.zeros_like(sweeps[0].normal)) / expected.thinning
    known = np.full(len(normal), 1.0)  # scales beside the pose: a second, a metre
    known[:6] = [KNOWN_M] * 3 + [KNOWN_RAD] * 3
    pull = sum((one.pull for one in sweeps), np.zeros_like(normal)) / expected.thinning
    prior = np.diag(expected.noise_m**2 / known**2)
    couplings = np.stack([one.coupling for one in sweeps]) / expected.thinning
    return sandwich(normal + prior, expected.noise_m**2 * (pull + prior), couplings, expected.shift_m**2)[:6, :6]


def spread(covariance: Array) -> tuple[float, float]:
    """1 sigma of the position (m) and of the rotation (rad), the three axes together."""
    return float(np.sqrt(np.trace(covariance[:3, :3]))), float(np.sqrt(np.trace(covariance[3:6, 3:6])))


def best_next(made: Sequence[Foreseen], candidates: Sequence[Foreseen], expected: Expected, lever_m: float) -> int:
    """Number of the candidate after which a point ``lever_m`` before the scanner is least uncertain."""

    def cost(one: Foreseen) -> float:
        sigma_m, sigma_rad = spread(covariance_after([*made, one], expected))
        return sigma_m**2 + (lever_m * sigma_rad) ** 2

    return int(np.argmin([cost(one) for one in candidates]))


def _sightings(sweep: Sweep, skin: Skin, mounting: Mounting) -> tuple[Sightings, NDArray[np.bool_], Array, Array]:
    """One sighting for each of the M samples of the skin that are met, which those are (N,), the cosine of incidence at
    each (M,), and how many rays meet each (M,)."""
    start, end = sweep.T_base_flange_start, sweep.T_base_flange_end
    T_base_scanner = start @ mounting.T_flange_scanner
    way = end.translation - start.translation
    forward = T_base_scanner.rotation.T @ way  # in the scanner's frame, which does not turn
    at_start = T_base_scanner.inverse().apply(skin.points)
    share = at_start[:, 1] / (forward[1] if abs(forward[1]) > 1e-9 else np.inf)
    in_plane = at_start - share[:, None] * forward
    x, z = in_plane[:, 0], np.maximum(in_plane[:, 2], 1e-6)
    ranges = np.hypot(x, z)
    steep = -np.einsum("ni,ni->n", skin.normals @ T_base_scanner.rotation, in_plane) / ranges
    met = (share > 0.0) & (share < 1.0) & (in_plane[:, 2] > 0.0) & (np.abs(x) < HALF_FAN * z) & (steep > skin.steepest)
    cell_m2 = (abs(forward[1]) / PROFILES) * (2.0 * HALF_FAN / RAYS * ranges[met])  # that one ray covers, square on
    count = int(met.sum())
    translations = start.translation + share[met, None] * way
    seen = Sightings(
        xz=in_plane[met][:, [0, 2]],
        profile=np.arange(count),
        sweep=np.zeros(count, dtype=np.int64),
        rotations=np.broadcast_to(start.rotation, (count, 3, 3)),
        translations=translations,
        velocities=np.broadcast_to(way / sweep.duration_s, (count, 3)),
        spins=np.zeros((count, 3)),
        starts=np.broadcast_to(start.translation, (count, 3)),
    )
    return seen, met, steep[met], skin.area_m2[met] * steep[met] / np.maximum(cell_m2, 1e-12)
