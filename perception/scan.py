"""What a sweep gives: laser profiles, the arm's pose at each, and the cloud they make together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from perception.errors import EmptyScanError
from perception.geometry import Array, Pose

Frame = Literal["scanner", "base"]


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """One laser line. The laser plane is y = 0 of the scanner frame; z points forward to the vehicle."""

    sequence: int
    """Number given by the device; gaps are lost profiles."""
    time_s: float
    """Host's monotonic time of the measurement, best estimate."""
    device_time_s: float | None
    """Time by the device's own clock, unwrapped; None where the device sends none."""
    points: Array
    """(M, 2): x and z in metres in the laser plane; only valid measurements."""
    intensity: Array | None = None
    """(M,) in the device's own unit, or None."""
    quality: float = 1.0
    """Share of the profile's samples that were valid, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points with, where it is known, where the laser stood when each was measured."""

    points: Array
    """(N, 3) in metres, all finite."""
    frame: Frame = "scanner"
    origins: Array | None = None
    """(N, 3) position of the laser for each point, in the same frame; None for a bare file."""

    def __len__(self) -> int:
        return len(self.points)

    def transformed(self, pose: Pose, frame: Frame) -> Cloud:
        """The same cloud seen from another frame (``pose`` = T_frame_thisframe)."""
        origins = None if self.origins is None else pose.apply(self.origins)
        return Cloud(pose.apply(self.points), frame, origins)


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A sweep: profiles, ``T_base_flange`` at each profile's time, and the hand-eye pose ``T_flange_scanner``."""

    profiles: tuple[Profile, ...]
    T_base_flange: tuple[Pose, ...]
    T_flange_scanner: Pose

    def to_cloud(self) -> Cloud:
        """The sweep as one cloud in the base frame. Raises EmptyScanError if no profile holds a point."""
        counts = [len(profile.points) for profile in self.profiles]
        if sum(counts) == 0:
            raise EmptyScanError("the sweep holds no valid point")
        poses = [flange @ self.T_flange_scanner for flange in self.T_base_flange]
        rotations = np.repeat(np.stack([pose.rotation for pose in poses]), counts, axis=0)
        origins = np.repeat(np.stack([pose.translation for pose in poses]), counts, axis=0)
        xz = np.concatenate([profile.points for profile in self.profiles])
        points = rotations[:, :, 0] * xz[:, :1] + rotations[:, :, 2] * xz[:, 1:] + origins
        finite = np.isfinite(points).all(axis=1)
        return Cloud(points[finite], "base", origins[finite])


def merge(clouds: Sequence[Cloud]) -> Cloud:
    """Several viewpoints of one scene, already in one frame, as one cloud."""
    frames = {cloud.frame for cloud in clouds}
    if len(frames) != 1:
        raise ValueError("clouds to merge are in one frame")
    origins = None
    if all(cloud.origins is not None for cloud in clouds):
        origins = np.concatenate([cloud.origins for cloud in clouds if cloud.origins is not None])
    return Cloud(np.concatenate([cloud.points for cloud in clouds]), clouds[0].frame, origins)
