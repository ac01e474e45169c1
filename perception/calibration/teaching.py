"""Teach by plugging: where the plug is, in the frame of the located port, while it is mated.

Errors of hand-eye, tool and model that are the same at every dock are in this pose too, and cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from perception.calibration.errors import CalibrationError
from perception.geometry import Array, Pose

MAX_SPREAD_M = 0.0003
MAX_SPREAD_RAD = float(np.deg2rad(0.2))
"""Scans that disagree by more do not tell where the port is."""
MIN_SCANS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """A taught plug pose."""

    T_port_tcp: Pose
    covariance: Array
    """(6, 6) of the mean: metres, then rotation vector in radians, port frame."""
    spread_m: float
    """Largest distance of a scan's plug pose from the mean."""
    spread_rad: float


def teach(T_base_port: Sequence[Pose], T_base_tcp_mated: Pose) -> Taught:
    """The mated plug in the port's frame, from several scans of the port that it was mated with.

    :param T_base_port: the port as each scan located it
    :param T_base_tcp_mated: where the arm held the plug while the charger said latched
    :raises CalibrationError: too few scans, or scans that disagree
    """
    if len(T_base_port) < MIN_SCANS:
        raise CalibrationError(f"{len(T_base_port)} scans are too few: at least {MIN_SCANS}")
    plugs = [port.inverse() @ T_base_tcp_mated for port in T_base_port]
    mean = mean_pose(plugs)
    off = np.stack([_difference(mean, plug) for plug in plugs])
    spread_m = float(np.linalg.norm(off[:, :3], axis=1).max())
    spread_rad = float(np.linalg.norm(off[:, 3:], axis=1).max())
    if spread_m > MAX_SPREAD_M or spread_rad > MAX_SPREAD_RAD:
        raise CalibrationError(
            f"the scans disagree by {1e3 * spread_m:.2f} mm and {np.rad2deg(spread_rad):.2f} deg",
            remedy="Check that the vehicle stands still and that the scanner sits tight; teach again.",
        )
    return Taught(mean, off.T @ off / (len(plugs) - 1) / len(plugs), spread_m, spread_rad)


def mean_pose(poses: Sequence[Pose]) -> Pose:
    """Mean translation and mean rotation (chordal)."""
    rotation = Rotation.from_matrix(np.stack([pose.rotation for pose in poses])).mean().as_matrix()
    return Pose(rotation, np.mean([pose.translation for pose in poses], axis=0))


def _difference(one: Pose, other: Pose) -> Array:
    """Translation in the outer frame and rotation vector (6,) from one pose to another."""
    turn = Rotation.from_matrix(one.rotation.T @ other.rotation).as_rotvec()
    return np.concatenate([other.translation - one.translation, one.rotate(turn)])
