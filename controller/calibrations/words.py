"""A calibration, and the difference of two, in words for the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np

from controller.calibrations.record import Calibration
from perception.geometry import Array, Pose

_NAMES = {"hand-eye": "T_flange_scanner", "tool": "T_flange_tcp", "port": "T_port_tcp"}


def described(one: Calibration, path: Path, now: datetime) -> Iterator[str]:
    """A few lines."""
    yield f"{one.slot}: {path.name}, {one.age_days(now):.1f} days old"
    yield f"  devices: arm {one.devices.arm}, scanner {one.devices.scanner}"
    yield f"  {_NAMES[one.kind]}: {pose_words(one.pose)}"
    yield f"  1 sigma: {one.sigma_mm:.3f} mm, {one.sigma_deg:.3f} deg"
    if one.latency_ms is not None:
        yield f"  latency_ms: {one.latency_ms:.2f}"
    if one.arm_errors is not None:
        yield f"  the arm: {arm_words(one.arm_errors)}"
    if one.made_with is not None:
        yield f"  made with: {one.made_with}"
    for name, value in one.residuals:
        yield f"  {name}: {value:.4g}"


def pose_words(pose: Pose) -> str:
    """``x y z mm, rx ry rz deg``."""
    place = " ".join(f"{1e3 * v:.3f}" for v in pose.translation)
    turn = " ".join(f"{v:.4f}" for v in np.rad2deg(pose.rotvec))
    return f"{place} mm, rotation vector {turn} deg"


def arm_words(errors: Array) -> str:
    """The largest of an arm's errors (19,)."""
    lengths_mm, zeros_deg = 1e3 * np.abs(errors[:12]).max(), np.rad2deg(np.abs(errors[12:18]).max())
    return (
        f"lengths up to {lengths_mm:.2f} mm, zeros up to {zeros_deg:.3f} deg off,"
        f" joints give {1e6 * errors[18]:.1f} urad/Nm"
    )


def compared(old: Calibration, new: Calibration) -> Iterator[str]:
    """What has changed, and whether that is more than both are uncertain by."""
    moved, turn = np.split(old.pose.change_to(new.pose), 2)
    sigma_mm = float(np.hypot(old.sigma_mm, new.sigma_mm))
    sigma_deg = float(np.hypot(old.sigma_deg, new.sigma_deg))
    moved_mm, turned_deg = 1e3 * float(np.linalg.norm(moved)), float(np.rad2deg(np.linalg.norm(turn)))
    place = ", ".join(f"{axis} {1e3 * v:+.3f}" for axis, v in zip("xyz", moved, strict=True))
    yield f"moved by {moved_mm:.3f} mm ({place}; 1 sigma of both together {sigma_mm:.3f})"
    yield f"turned by {turned_deg:.3f} deg (1 sigma of both together {sigma_deg:.3f})"
    if old.latency_ms is not None and new.latency_ms is not None:
        yield f"latency_ms from {old.latency_ms:.2f} to {new.latency_ms:.2f}"
    changed = moved_mm > 3.0 * sigma_mm or turned_deg > 3.0 * sigma_deg
    yield "that is a change: the mounting moved" if changed else "that is within what the two leave uncertain"
