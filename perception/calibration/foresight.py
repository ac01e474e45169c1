"""What a sweep that has not been made yet would add: the poses of a calibration are chosen by it.

A candidate's sweep of a sphere is foreseen without noise; sweeps are then taken up one by one, each time the one after
which the mounting is least uncertain (greedy design of experiments).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.calibration.hand_eye import Asked, mounting_jacobian
from perception.calibration.sightings import Mounting, Sightings
from perception.calibration.targets import SphereTarget
from perception.calibration.uncertainty import coupling, sandwich
from perception.geometry import Array, Pose

PROFILES = 90
RAYS = 90
HALF_FAN = 0.28
"""Tangent of half the laser fan's angle."""
STEEPEST = 0.42
"""Cosine of the steepest incidence at which the solver takes ranges."""


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
    coupling: Array
    """(K, 3)."""
    points: int
    """So many of its rays meet the target: few mean that the sweep would miss it."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A straight sweep at constant speed."""

    T_base_flange_start: Pose
    T_base_flange_end: Pose
    duration_s: float


def foreseen(sweep: Sweep, target: SphereTarget, mounting: Mounting, asked: Asked) -> Foreseen:
    """What a sweep of a sphere would add."""
    seen = _sightings(sweep, target, mounting)
    distances = target.distances(seen.in_base(mounting))
    jacobian = np.column_stack([mounting_jacobian(seen, mounting, distances)[:, asked.columns], distances.own])
    pull = coupling(jacobian, np.ones(len(seen)), distances.gradient)
    return Foreseen(jacobian.T @ jacobian, pull, len(seen))


def covariance_after(sweeps: Sequence[Foreseen], expected: Expected) -> Array:
    """(6, 6) of the mounting's pose after all these sweeps, what is known beforehand counted in."""
    normal = sum((one.normal for one in sweeps), np.zeros_like(sweeps[0].normal)) / expected.thinning
    known = np.full(len(normal), 1.0)  # scales beside the pose: a second, a metre
    known[:6] = [KNOWN_M] * 3 + [KNOWN_RAD] * 3
    normal = normal + np.diag(expected.noise_m**2 / known**2)
    pulls = np.stack([one.coupling for one in sweeps]) / expected.thinning
    return sandwich(normal, expected.noise_m**2 * normal, pulls, expected.shift_m**2)[:6, :6]


def spread(covariance: Array) -> tuple[float, float]:
    """1 sigma of the position (m) and of the rotation (rad), the three axes together."""
    return float(np.sqrt(np.trace(covariance[:3, :3]))), float(np.sqrt(np.trace(covariance[3:6, 3:6])))


def best_next(made: Sequence[Foreseen], candidates: Sequence[Foreseen], expected: Expected, lever_m: float) -> int:
    """Number of the candidate after which a point ``lever_m`` before the scanner is least uncertain."""

    def cost(one: Foreseen) -> float:
        sigma_m, sigma_rad = spread(covariance_after([*made, one], expected))
        return sigma_m**2 + (lever_m * sigma_rad) ** 2

    return int(np.argmin([cost(one) for one in candidates]))


def _sightings(sweep: Sweep, target: SphereTarget, mounting: Mounting) -> Sightings:
    """The points that an ideal scanner sees of the sphere."""
    share = np.linspace(0.0, 1.0, PROFILES)[:, None]
    start, end = sweep.T_base_flange_start, sweep.T_base_flange_end
    way = end.translation - start.translation
    translations = start.translation + share * way
    rotations = np.broadcast_to(start.rotation, (PROFILES, 3, 3))
    x = np.linspace(-HALF_FAN, HALF_FAN, RAYS)
    fan = np.column_stack([x, np.zeros(RAYS), np.ones(RAYS)]) / np.sqrt(1.0 + x**2)[:, None]
    T_fs = mounting.T_flange_scanner
    rays = fan @ (start.rotation @ T_fs.rotation).T
    to_centre = target.centre - (translations + start.rotate(T_fs.translation))  # (P, 3)
    along = to_centre @ rays.T
    root = along**2 - np.sum(to_centre**2, axis=1)[:, None] + target.radius_m**2
    steep = np.sqrt(np.maximum(root, 0.0)) / target.radius_m
    profile, ray = np.nonzero((root > 0) & (steep > STEEPEST))
    ranges = along[profile, ray] - np.sqrt(root[profile, ray])
    velocity = np.broadcast_to(way / sweep.duration_s, (PROFILES, 3))
    return Sightings(
        xz=ranges[:, None] * fan[ray][:, [0, 2]],
        profile=profile,
        sweep=np.zeros(PROFILES, dtype=np.int64),
        rotations=rotations,
        translations=translations,
        velocities=velocity,
        spins=np.zeros((PROFILES, 3)),
        starts=np.broadcast_to(translations[0], (PROFILES, 3)),
    )
