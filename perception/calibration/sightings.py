"""What the scanner saw in several sweeps, profile by profile, with the flange's pose and motion at each profile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from perception.calibration.errors import CalibrationError
from perception.geometry import Array, Pose
from perception.scan import Scan

MIN_PROFILES = 5


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """What a hand-eye calibration estimates."""

    T_flange_scanner: Pose
    time_offset_s: float = 0.0
    """To be added to a profile's time: positive where the measurement was later than its time stamp said."""
    speed_scale: float = 1.0
    """Length of the true way of a sweep over the length that the arm reported."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """N points of P profiles of several sweeps. Poses are the flange's in the base frame."""

    xz: Array
    """(N, 2) in the laser plane, metres."""
    profile: NDArray[np.int64]
    """(N,) number of the point's profile."""
    sweep: NDArray[np.int64]
    """(P,) number of the profile's sweep."""
    rotations: Array
    """(P, 3, 3)."""
    translations: Array
    """(P, 3)."""
    velocities: Array
    """(P, 3) m/s."""
    spins: Array
    """(P, 3) rad/s, in the base frame."""
    starts: Array
    """(P, 3) where the profile's sweep began."""

    def __len__(self) -> int:
        return len(self.xz)

    @property
    def sweep_of_point(self) -> NDArray[np.int64]:
        """(N,)."""
        return self.sweep[self.profile]

    def of(self, points: NDArray[np.bool_]) -> Sightings:
        """The same profiles with only some of the points (N,)."""
        return replace(self, xz=self.xz[points], profile=self.profile[points])

    def in_base(self, mounting: Mounting) -> Array:
        """(N, 3) points in the base frame, were the scanner mounted so."""
        in_flange = self.in_flange(mounting.T_flange_scanner)
        turned = np.einsum("nij,nj->ni", self.rotations[self.profile], in_flange)
        dt_s = mounting.time_offset_s
        turned = turned + dt_s * np.cross(self.spins[self.profile], turned)
        way = self.translations - self.starts
        flange = self.starts + mounting.speed_scale * (way + dt_s * self.velocities)
        return np.asarray(turned + flange[self.profile])

    def in_flange(self, T_flange_scanner: Pose) -> Array:
        """(N, 3) points in the flange's frame."""
        r = T_flange_scanner.rotation
        return np.asarray(self.xz[:, :1] * r[:, 0] + self.xz[:, 1:] * r[:, 2] + T_flange_scanner.translation)


def sightings(scans: Sequence[Scan], max_points: int = 6000) -> Sightings:
    """Sightings of several sweeps, at most ``max_points`` evenly chosen points of each.

    :raises CalibrationError: a sweep holds too few profiles or no points
    """
    parts = [_of_sweep(scan, number, max_points) for number, scan in enumerate(scans)]
    if not parts:
        raise CalibrationError("there are no sweeps to calibrate from")
    first = np.cumsum([0, *(len(part.sweep) for part in parts)])
    return Sightings(
        xz=np.concatenate([part.xz for part in parts]),
        profile=np.concatenate([part.profile + start for part, start in zip(parts, first[:-1], strict=True)]),
        sweep=np.concatenate([part.sweep for part in parts]),
        rotations=np.concatenate([part.rotations for part in parts]),
        translations=np.concatenate([part.translations for part in parts]),
        velocities=np.concatenate([part.velocities for part in parts]),
        spins=np.concatenate([part.spins for part in parts]),
        starts=np.concatenate([part.starts for part in parts]),
    )


def _of_sweep(scan: Scan, number: int, max_points: int) -> Sightings:
    scan = _of_growing_time(scan)
    counts = [len(profile.points) for profile in scan.profiles]
    if len(counts) < MIN_PROFILES or sum(counts) == 0:
        raise CalibrationError(f"sweep {number + 1} holds {len(counts)} profiles with {sum(counts)} points")
    xz = np.concatenate([profile.points for profile in scan.profiles])
    owner = np.repeat(np.arange(len(counts)), counts)
    chosen = np.unique(np.linspace(0, len(xz) - 1, min(max_points, len(xz))).astype(np.int64))
    times_s = np.array([profile.time_s for profile in scan.profiles])
    rotations = np.stack([pose.rotation for pose in scan.T_base_flange])
    translations = np.stack([pose.translation for pose in scan.T_base_flange])
    return Sightings(
        xz=xz[chosen],
        profile=owner[chosen],
        sweep=np.full(len(counts), number),
        rotations=rotations,
        translations=translations,
        velocities=np.gradient(translations, times_s, axis=0),
        spins=_spins(rotations, times_s),
        starts=np.broadcast_to(translations[0], translations.shape),
    )


def _of_growing_time(scan: Scan) -> Scan:
    """Without profiles that bear the time of one before: the arm's speed between them would be infinite."""
    times_s = np.array([profile.time_s for profile in scan.profiles])
    newer = np.concatenate([[True], times_s[1:] > np.maximum.accumulate(times_s)[:-1]])
    kept = [(profile, pose) for profile, pose, new in zip(scan.profiles, scan.T_base_flange, newer, strict=True) if new]
    return Scan(tuple(profile for profile, _ in kept), tuple(pose for _, pose in kept), scan.T_flange_scanner)


def _spins(rotations: Array, times_s: Array) -> Array:
    """Angular velocities (P, 3) in the base frame, by differences between neighbours."""
    turns = Rotation.from_matrix(rotations[1:] @ rotations[:-1].transpose(0, 2, 1)).as_rotvec()
    rates = turns / np.diff(times_s)[:, None]
    return np.concatenate([rates[:1], 0.5 * (rates[1:] + rates[:-1]), rates[-1:]])
