"""Sweeps of a sphere or of a corner by a scanner on an ideal or an erring arm, ray-cast here and nowhere else."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from perception.geometry import Array, Pose, exp
from perception.scan import Profile, Scan

RADIUS_M = 0.0254
CENTRE = np.array([0.9, 0.1, 0.5])
T_FLANGE_SCANNER = Pose.from_rotvec([0.05, -0.03, 0.1], [0.0, -0.09, 0.04])
CORNER = np.array([[-2.0, 2.0, 2.0], [-2.0, -3.0, 0.5], [-2.0, 0.8, -2.6]])
CORNER /= np.linalg.norm(CORNER, axis=1)[:, None]
"""Rows: outward normals of three planes that meet in ``CENTRE`` and point at the scanner like the corner of a box."""


@dataclass(frozen=True)
class Rig:
    """How the sweeps are made."""

    target: str = "sphere"
    sweeps: int = 8
    noise_m: float = 1e-4
    time_offset_s: float = 0.0
    speed_scale: float = 1.0
    """True way over reported way."""
    arm_error_m: float = 0.0
    """1 sigma of each component of the arm's error in a pose; its rotation errs by a mrad per millimetre."""
    tilts: bool = True
    """False: all sweeps have one orientation and direction."""
    moved_in_last_m: float = 0.0
    """The target has moved before the last sweep."""
    hidden_beyond_m: float = np.inf
    """Points further than this along the base's y from the centre are hidden."""
    radius_m: float = RADIUS_M
    speed_m_s: float = 0.03
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def scans(self) -> list[Scan]:
        """One for each sweep, as the controller would have them: the arm's word for its poses."""
        return [self._sweep(number) for number in range(self.sweeps)]

    def _sweep(self, number: int) -> Scan:
        angle = 2.0 * np.pi * number / self.sweeps if self.tilts else 0.0
        spread = 0.5 if self.tilts else 0.0
        direction = np.array([-1.0, spread * np.cos(angle), spread * np.sin(angle)])
        place = CENTRE + (self.rng.uniform(-0.03, 0.03, 3) if self.tilts else 0.0)
        roll = self.rng.uniform(-1, 1) if self.tilts else 0.0
        middle = _looking_at(place, direction, 0.29 + (self.rng.uniform(-0.04, 0.04) if self.tilts else 0.0), roll)
        along = middle.rotation[:, 1] * (1.0 if number % 2 or not self.tilts else -1.0)
        times_s = np.arange(120) / 120 * 0.12 / self.speed_m_s
        moved = np.array([0.0, 1.0, 0.0]) * (self.moved_in_last_m if number == self.sweeps - 1 else 0.0)
        erring = exp(self.rng.normal(size=6) * self.arm_error_m)

        def scanner(time_s: float, scale: float) -> Pose:
            return Pose(middle.rotation, middle.translation + along * (scale * time_s * self.speed_m_s - 0.06))

        profiles, flanges = [], []
        for k, time_s in enumerate(times_s):
            true = scanner(time_s + self.time_offset_s, self.speed_scale)
            profiles.append(Profile(k, float(time_s), float(time_s), self._profile(true, CENTRE + moved)))
            flanges.append(scanner(float(time_s), 1.0) @ T_FLANGE_SCANNER.inverse() @ erring)
        return Scan(tuple(profiles), tuple(flanges), T_FLANGE_SCANNER)

    def _profile(self, T_base_scanner: Pose, centre: Array) -> Array:
        angles = np.linspace(-0.2, 0.2, 200)
        rays = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)
        directions, origin = T_base_scanner.rotate(rays), T_base_scanner.translation
        hits = self._hits(directions, origin, centre)
        ranges = hits + self.rng.normal(0, self.noise_m, len(hits))
        place = origin + directions * np.where(np.isfinite(hits), hits, 0.0)[:, None]
        seen = np.isfinite(hits) & (hits < 1.0) & (place[:, 1] - centre[1] < self.hidden_beyond_m)
        return np.asarray((rays * ranges[:, None])[seen][:, [0, 2]])

    def _hits(self, directions: Array, origin: Array, centre: Array) -> Array:
        if self.target == "corner":
            ranges = (CORNER @ (centre - origin)) / (directions @ CORNER.T)
            return np.asarray(np.where(ranges > 0, ranges, -np.inf).max(axis=1))
        b = directions @ (origin - centre)
        root = b**2 - (origin - centre) @ (origin - centre) + self.radius_m**2
        ball = np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)
        wall = (CENTRE[0] + 0.12 - origin[0]) / directions[:, 0]
        return np.minimum(ball, np.where(wall > 0, wall, np.inf))


def _looking_at(place: Array, direction: Array, distance_m: float, roll_rad: float) -> Pose:
    z = -direction / np.linalg.norm(direction)
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    facing = Pose(np.stack([x, np.cross(z, x), z], axis=1), place - z * distance_m)
    return facing @ exp([0.0, 0.0, 0.0, 0.0, 0.0, roll_rad])
