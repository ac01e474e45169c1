"""Raw numbers of good frames -> points in the laser plane. Pure, one numpy pass for a batch of frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frame_format import FrameFormat, PointArray
from perception.geometry import Array

Frames = NDArray[Any]
"""(N,) structured array of ``FrameFormat.dtype``."""


def decode_points(frames: Frames, layout: FrameFormat) -> tuple[Array, NDArray[np.bool_], Array | None]:
    """Points (N, M, 2) in metres, which of them were measured (N, M), intensity (N, M) or None."""
    points = layout.points
    raw = frames["points"]
    depth_raw = raw["range"] if points.layout == "polar" else raw["z"]
    valid = np.isfinite(depth_raw) if depth_raw.dtype.kind == "f" else np.ones(depth_raw.shape, bool)
    for value in points.invalid:
        valid &= depth_raw != value
    depth = depth_raw * points.scaling.scale_m + points.scaling.offset_m
    if points.layout == "polar":
        angle = _angles(frames, points)
        x, z = depth * np.sin(angle), depth * np.cos(angle)
    elif points.layout == "xz":
        x, z = raw["x"] * points.x_scaling.scale_m + points.x_scaling.offset_m, depth
    else:
        x, z = np.broadcast_to(points.x_start_m + points.x_step_m * np.arange(points.count), depth.shape), depth
    has_intensity = any(field.name == "intensity" for field in points.item)
    intensity = raw["intensity"].astype(np.float64) if has_intensity else None
    return np.stack([x, z], axis=2), valid, intensity


def _angles(frames: Frames, points: PointArray) -> Array:
    """Angle (N, M) in radians of each range, even between the first and the last angle, through 360 degrees."""
    first = frames[points.first_angle][:, None] * points.angle_unit_rad
    last = frames[points.last_angle][:, None] * points.angle_unit_rad
    span = np.mod(last - first, 2 * np.pi)
    angle = first + span * np.arange(points.count) / max(1, points.count - 1)
    return np.asarray(points.angle_sign * angle + points.angle_offset_rad)
