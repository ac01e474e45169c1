"""A cloud as a file's bytes: PLY, PCD (binary) and NPZ, metres. ``cloud_io`` reads them all back."""

from __future__ import annotations

import io

import numpy as np

from perception.geometry import Array
from perception.scan import Cloud


def ply_bytes(points: Array, frame: str) -> bytes:
    """Points (N, 3) in metres as a binary little-endian PLY file."""
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment portdock: metres, frame {frame}\nelement vertex {len(points)}\n"
    )
    properties = "".join(f"property double {axis}\n" for axis in "xyz")
    return (header + properties + "end_header\n").encode() + np.ascontiguousarray(points, dtype="<f8").tobytes()


def pcd_bytes(points: Array, frame: str) -> bytes:
    """Points (N, 3) in metres as a binary PCD file, version 0.7."""
    lines = (
        f"# portdock: metres, frame {frame}",
        "VERSION 0.7",
        "FIELDS x y z",
        "SIZE 8 8 8",
        "TYPE F F F",
        "COUNT 1 1 1",
        f"WIDTH {len(points)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(points)}",
        "DATA binary",
    )
    return ("\n".join(lines) + "\n").encode() + np.ascontiguousarray(points, dtype="<f8").tobytes()


def npz_bytes(cloud: Cloud) -> bytes:
    """Points, and the laser's places where they are known, as compressed numpy arrays."""
    buffer = io.BytesIO()
    if cloud.origins is None:
        np.savez_compressed(buffer, points=cloud.points)
    else:
        np.savez_compressed(buffer, points=cloud.points, origins=cloud.origins)
    return buffer.getvalue()
