"""From where a calibration target is swept: candidates about the target, and which of them the arm can follow. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.config import ScanConfig
from controller.planning import FACING, ReachCheck, Viewpoint
from perception.geometry import Pose

GOLDEN_RAD = float(np.pi * (3.0 - np.sqrt(5.0)))
TILTS_DEG = (22.0, 14.0, 26.0)
ROLLS_DEG = (0.0, 35.0, -35.0, 70.0, -20.0)
STANDOFFS_MM = (0.0, 35.0, -35.0)
"""Added to the site's stand-off."""
ASIDE_MM = (0.0, 28.0, -28.0)
"""Of the target from the middle of the laser line."""


CLEAR_M = 0.07
"""Of the plug from the plane of the target, along the line of sight."""


@dataclass(frozen=True, slots=True)
class View:
    """One way to look at a target: tilted about the expected port's axes, turned about the line of sight."""

    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    nearer_mm: float = 0.0
    aside_mm: float = 0.0
    backwards: bool = False


def candidates(count: int) -> tuple[View, ...]:
    """Views that differ in all that matters: tilt, roll, stand-off, place on the line, direction of the sweep."""
    views = []
    for k in range(count):
        tilt_deg, angle = TILTS_DEG[k % len(TILTS_DEG)], k * GOLDEN_RAD
        pitch_deg, yaw_deg = tilt_deg * np.array([np.cos(angle), np.sin(angle)])
        roll_deg, nearer_mm = ROLLS_DEG[k % len(ROLLS_DEG)], STANDOFFS_MM[(k // 2) % len(STANDOFFS_MM)]
        aside_mm = ASIDE_MM[(k // 3) % len(ASIDE_MM)]
        views.append(View(float(pitch_deg), float(yaw_deg), roll_deg, nearer_mm, aside_mm, k % 2 == 1))
    return tuple(views)


def sweep_of(view: View, T_base_target: Pose, scan: ScanConfig, T_scanner_tcp: Pose) -> Viewpoint:
    """The straight sweep over a target's origin; the target's axes are those of a port."""
    tilt = Pose.from_rotvec(np.deg2rad([view.pitch_deg, view.yaw_deg, 0.0]))
    standoff_m = (scan.standoff_mm - view.nearer_mm) / 1000.0
    roll = Pose.from_rotvec([0.0, 0.0, np.deg2rad(view.roll_deg)])
    middle = tilt @ Pose(FACING, np.array([0.0, 0.0, standoff_m])) @ roll
    half_m, aside_m = scan.length_mm / 2000.0, view.aside_mm / 1000.0
    start, end = (
        T_base_target @ middle @ Pose(np.eye(3), np.array([aside_m, y, 0.0])) @ T_scanner_tcp
        for y in ((half_m, -half_m) if view.backwards else (-half_m, half_m))
    )
    return Viewpoint(start, end)


def reachable(viewpoint: Viewpoint, T_base_target: Pose, reach: ReachCheck) -> str | None:
    """Why the arm cannot go to the sweep's start and along it, or None: reach, limits, singularities, collisions.

    The plug is nearer to the target than the scanner, and the target's place is not known well at first.
    """
    T_target_base = T_base_target.inverse()
    for pose in (viewpoint.T_base_tcp_start, viewpoint.T_base_tcp_end):
        if (T_target_base @ pose).translation[2] < CLEAR_M:
            return f"the plug would come nearer than {1e3 * CLEAR_M:.0f} mm to the target"
    return reach([viewpoint.T_base_tcp_start, viewpoint.T_base_tcp_end])
