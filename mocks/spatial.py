"""Small rotation algebra for what the mocks do hundreds of times a second: a library's checks would cost more.

Poses are (4, 4); a pose vector is UR's p[x, y, z, rx, ry, rz] with a rotation vector in radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from perception.geometry import Array


def rotation_of(rotvec: Sequence[float] | Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (Rodrigues)."""
    x, y, z = float(rotvec[0]), float(rotvec[1]), float(rotvec[2])
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    x, y, z = x / angle, y / angle, z / angle
    c, s = math.cos(angle), math.sin(angle)
    t = 1.0 - c
    return np.array(
        [
            [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
            [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
            [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
        ]
    )


def rotvec_of(R: Array) -> Array:
    """Rotation vector (3,) of a rotation matrix, angle in [0, pi]."""
    sx, sy, sz = float(R[2, 1] - R[1, 2]), float(R[0, 2] - R[2, 0]), float(R[1, 0] - R[0, 1])
    sine = 0.5 * math.sqrt(sx * sx + sy * sy + sz * sz)
    cosine = 0.5 * (float(R[0, 0] + R[1, 1] + R[2, 2]) - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        factor = 0.5 * angle / sine
        return np.array([sx * factor, sy * factor, sz * factor])
    if cosine > 0.0:
        return np.array([0.5 * sx, 0.5 * sy, 0.5 * sz])
    outer = 0.5 * (R + np.eye(3))  # half a turn: the axis is the largest column of a a^T
    column = int(np.argmax(np.diag(outer)))
    axis = outer[:, column] / math.sqrt(float(outer[column, column]))
    return np.asarray(axis * angle)


def matrix_of(pose: Sequence[float] | Array) -> Array:
    """Pose (4, 4) of a pose vector."""
    T = np.eye(4)
    T[:3, :3] = rotation_of(pose[3:6])
    T[:3, 3] = pose[:3]
    return T


def pose_of(T: Array) -> Array:
    """Pose vector (6,) of a pose (4, 4)."""
    return np.concatenate([T[:3, 3], rotvec_of(T[:3, :3])])


def inverse_of(T: Array) -> Array:
    """Inverse of a pose (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse


def twist_between(T_from: Array, T_to: Array) -> Array:
    """Translation (m) and rotation vector (rad), both in base axes, that lead from one pose to another: (6,)."""
    return np.concatenate([T_to[:3, 3] - T_from[:3, 3], rotvec_of(T_to[:3, :3] @ T_from[:3, :3].T)])


def moved_by(T: Array, twist: Array) -> Array:
    """The pose after a small translation and rotation in base axes."""
    moved = T.copy()
    moved[:3, 3] += twist[:3]
    moved[:3, :3] = rotation_of(twist[3:]) @ T[:3, :3]
    return moved
