"""Coarse alignment of many candidate poses at once: robust point-to-plane steps with table look-up.

All candidates advance together as one batch of matrix products; the gate narrows from step to step.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from perception.geometry import Array, Pose
from perception.port_model import PortModel

_GATES_M = (0.006, 0.005, 0.004, 0.003, 0.002, 0.0015, 0.0015)
_MIN_COSINE = 0.6
_MAX_STEP_RAD = 0.06
_MAX_STEP_M = 0.004


def align(poses: list[Pose], points: Array, normals: Array, model: PortModel, weights: Array) -> list[Pose]:
    """The poses after a few alignment steps each.

    :param poses: T_prior_port of each candidate.
    :param points: (N, 3) scan points in the prior frame, some thousands.
    :param normals: (N, 3) their normals.
    :param weights: (M + 1,) weight of each model sample; the last entry, for no sample near, is 0.
    """
    rotation = np.stack([pose.rotation for pose in poses])
    translation = np.stack([pose.translation for pose in poses])
    surface = np.vstack([model.surface.points, np.zeros(3)])
    facing = np.vstack([model.surface.normals, np.zeros(3)])
    for gate in _GATES_M:
        local = (points[None] - translation[:, None]) @ rotation
        turned = normals[None] @ rotation
        index = model.nearest.lookup(local)
        n = facing[index]
        gap = local - surface[index]
        distance = np.einsum("knj,knj->kn", gap, n)
        cosine = np.einsum("knj,knj->kn", turned, n)
        inlier = (
            (np.abs(distance) < gate)
            & (cosine > _MIN_COSINE)
            & (np.einsum("knj,knj->kn", gap, gap) < (1.5 * gate) ** 2)
        )
        w = np.where(inlier, (1.0 - (distance / gate) ** 2) ** 2, 0.0) * weights[index]
        step = _solve(local, n, distance, w)
        turn = Rotation.from_rotvec(step[:, 3:]).as_matrix()
        # The model moves by the inverse of what would bring the scan onto it.
        translation = translation - np.einsum("kij,kj->ki", rotation, np.einsum("kji,kj->ki", turn, step[:, :3]))
        rotation = rotation @ np.transpose(turn, (0, 2, 1))
    return [Pose(r, t) for r, t in zip(rotation, translation, strict=True)]


def _solve(local: Array, n: Array, distance: Array, w: Array) -> Array:
    """Steps (K, 6), translation then rotation vector, that bring the local points onto the planes; bounded."""
    jacobian = np.concatenate([n, np.cross(local, n)], axis=2)
    weighted = jacobian * w[:, :, None]
    information = np.transpose(weighted, (0, 2, 1)) @ jacobian
    gradient = -np.einsum("kni,kn->ki", weighted, distance)
    total = w.sum(axis=1)
    damping = np.array([1e-3] * 3 + [1e-3 * 0.03**2] * 3)
    information += np.eye(6) * damping * (total[:, None, None] + 1.0)
    step: Array = np.linalg.solve(information, gradient[..., None])[..., 0]
    step[:, :3] *= np.minimum(1.0, _MAX_STEP_M / np.maximum(np.linalg.norm(step[:, :3], axis=1), 1e-12))[:, None]
    step[:, 3:] *= np.minimum(1.0, _MAX_STEP_RAD / np.maximum(np.linalg.norm(step[:, 3:], axis=1), 1e-12))[:, None]
    return step
