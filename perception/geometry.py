"""Rigid transforms. A ``Pose`` named ``T_a_b`` is the pose of frame b in frame a: it maps b's coordinates to a's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]


PACKED_AT_MOST = 20_000
"""More points are not given to BLAS: OpenBLAS packs them into buffers that it never gives back and that fill up further
with each other number of points, by tens of megabytes in a process that runs for months."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform: ``rotation`` (3, 3) orthonormal with determinant +1, ``translation`` (3,) in metres."""

    rotation: Array
    translation: Array

    @staticmethod
    def identity() -> Pose:
        """The pose that changes nothing."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> Pose:
        """From a 4x4 homogeneous matrix. Raises ValueError for another shape, a non-finite entry or a non-rotation."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all():
            raise ValueError("a pose is a finite 4x4 matrix")
        rotation = m[:3, :3]
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
            raise ValueError("the upper left 3x3 of a pose is a rotation")
        return Pose(rotation.copy(), m[:3, 3].copy())

    @staticmethod
    def from_vector(vector: ArrayLike) -> Pose:
        """From (x, y, z, rx, ry, rz): metres and a rotation vector in radians, as Universal Robots writes a pose."""
        v = np.asarray(vector, dtype=np.float64)
        if v.shape != (6,):
            raise ValueError("a pose vector has six entries")
        rotation = np.array(Rotation.from_rotvec(v[3:]).as_matrix())  # scipy's own is a view that keeps five objects
        return Pose(rotation, v[:3].copy())

    @staticmethod
    def from_rotvec(rotvec: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
        """From a rotation vector (rad) and a translation (m)."""
        rotation = Rotation.from_rotvec(np.asarray(rotvec, dtype=np.float64)).as_matrix()
        return Pose(rotation, np.asarray(translation, dtype=np.float64).copy())

    @cached_property
    def matrix(self) -> Array:
        """The 4x4 homogeneous matrix."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        m[:3, 3] = self.translation
        return m

    @property
    def rotvec(self) -> Array:
        """The rotation vector (3,) in radians."""
        return np.asarray(Rotation.from_matrix(self.rotation).as_rotvec())

    @property
    def vector(self) -> Array:
        """(x, y, z, rx, ry, rz): metres and radians."""
        return np.concatenate([self.translation, self.rotvec])

    def __matmul__(self, other: Pose) -> Pose:
        """``T_a_b @ T_b_c`` is ``T_a_c``."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def change_to(self, other: Pose) -> Array:
        """(6,) from this pose to another of the same two frames: metres in the outer one, radians in the inner one."""
        return np.concatenate([other.translation - self.translation, (self.inverse() @ other).rotvec])

    def inverse(self) -> Pose:
        """``T_b_a`` of ``T_a_b``."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def apply(self, points: Array) -> Array:
        """Points (N, 3) or one point (3,), from frame b to frame a."""
        return np.asarray(self.rotate(points) + self.translation)

    def rotate(self, vectors: Array) -> Array:
        """Free vectors (N, 3) or (3,), from frame b to frame a: rotation only."""
        if vectors.ndim == 2 and len(vectors) > PACKED_AT_MOST:
            x, y, z = self.rotation.T
            return np.asarray(vectors[:, :1] * x + vectors[:, 1:2] * y + vectors[:, 2:] * z)
        return np.asarray(vectors @ self.rotation.T)

    def moved(self, offset: ArrayLike) -> Pose:
        """This pose shifted by ``offset`` (3,) metres along its own axes."""
        return Pose(self.rotation, self.translation + self.rotation @ np.asarray(offset, dtype=np.float64))

    def angle_to(self, other: Pose) -> float:
        """Geodesic angle between two orientations, in radians."""
        return float(Rotation.from_matrix(self.rotation.T @ other.rotation).magnitude())

    def distance_to(self, other: Pose) -> float:
        """Distance between two origins, in metres."""
        return float(np.linalg.norm(self.translation - other.translation))


def exp(twist: ArrayLike) -> Pose:
    """Small motion (translation, rotation vector) (6,) as a pose; rotation and translation are not coupled."""
    t = np.asarray(twist, dtype=np.float64)
    return Pose.from_rotvec(t[3:], t[:3])


def exp_many(twists: Array) -> Array:
    """(P, 4, 4) matrices of ``exp`` of each twist (P, 6)."""
    matrices = np.tile(np.eye(4), (len(twists), 1, 1))
    matrices[:, :3, :3] = Rotation.from_rotvec(twists[:, 3:]).as_matrix()
    matrices[:, :3, 3] = twists[:, :3]
    return matrices


def interpolate(times_s: Sequence[float] | Array, poses: Sequence[Pose], query_s: ArrayLike) -> list[Pose]:
    """Poses at ``query_s``: linear in translation, slerp in rotation. Queries outside ``times_s`` raise ValueError."""
    times = np.asarray(times_s, dtype=np.float64)
    query = np.atleast_1d(np.asarray(query_s, dtype=np.float64))
    if len(times) < 2 or query.min() < times[0] or query.max() > times[-1]:
        raise ValueError("query time outside the known poses")
    translations = np.stack([pose.translation for pose in poses])
    rotations = Slerp(times, Rotation.from_matrix(np.stack([pose.rotation for pose in poses])))(query).as_matrix()
    moved = np.stack([np.interp(query, times, translations[:, k]) for k in range(3)], axis=1)
    return [Pose(r, t) for r, t in zip(rotations, moved, strict=True)]
