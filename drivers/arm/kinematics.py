"""Kinematics of Universal Robots arms from their nominal Denavit-Hartenberg parameters: pure functions.

For feasibility, choice of branch and distance from singularities on the host, before a command is sent. A real arm's
calibration differs from the nominal values by millimetres, so poses that matter are left to the controller's own
kinematics. All poses are ``T_base_flange``; joints are (6,) in radians in the controller's order and sign.

Functions ending in ``_many`` take a stack of K poses or joint vectors and are vectorised over it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry import Array, Pose

BRANCHES = 8
"""Shoulder left or right, wrist flipped or not, elbow up or down."""

_COSINE_SLACK = 1e-6
"""A cosine that rounding pushes beyond 1 by this much is still 1: a micrometre of reach."""
_WRIST_SINGULAR = 1e-6
"""Below this |sin(q5)| the axes of joints 4 and 6 are parallel and q6 is free."""


@dataclass(frozen=True, slots=True)
class ArmModel:
    """Nominal Denavit-Hartenberg lengths in metres, as Universal Robots publishes them for each model."""

    name: str
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float


_MODELS = (
    ArmModel("ur3e", 0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    ArmModel("ur5e", 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    ArmModel("ur7e", 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    ArmModel("ur10e", 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    ArmModel("ur12e", 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    ArmModel("ur15", 0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    ArmModel("ur16e", 0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    ArmModel("ur20", 0.2363, -0.8620, -0.7287, 0.2010, 0.1593, 0.1543),
    ArmModel("ur30", 0.2363, -0.6370, -0.5037, 0.2010, 0.1593, 0.1543),
)
MODELS: dict[str, ArmModel] = {model.name: model for model in _MODELS}


@dataclass(frozen=True, slots=True, eq=False)
class JointLimits:
    """Lowest and highest angle of each joint, (6,) rad."""

    lower: Array
    upper: Array

    @staticmethod
    def symmetric(limit_rad: float = 2.0 * np.pi) -> JointLimits:
        """The same range for every joint; UR's own is one turn either way."""
        return JointLimits(np.full(6, -limit_rad), np.full(6, limit_rad))

    def hold(self, joints: Array) -> bool:
        """Whether all of ``joints`` (..., 6) are inside."""
        return bool(np.all((joints >= self.lower - 1e-9) & (joints <= self.upper + 1e-9)))


def _link_matrices(model: ArmModel, joints: Array) -> Array:
    """(K, 6, 4, 4): transform of each link in the frame before it, standard Denavit-Hartenberg."""
    cos, sin = np.cos(joints), np.sin(joints)
    cos_alpha = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    sin_alpha = np.array([1.0, 0.0, 0.0, 1.0, -1.0, 0.0])
    a = np.array([0.0, model.a2, model.a3, 0.0, 0.0, 0.0])
    d = np.array([model.d1, 0.0, 0.0, model.d4, model.d5, model.d6])
    links = np.zeros((*joints.shape, 4, 4))
    links[..., 0, 0], links[..., 0, 1], links[..., 0, 2] = cos, -sin * cos_alpha, sin * sin_alpha
    links[..., 1, 0], links[..., 1, 1], links[..., 1, 2] = sin, cos * cos_alpha, -cos * sin_alpha
    links[..., 2, 1], links[..., 2, 2] = sin_alpha, cos_alpha
    links[..., 0, 3], links[..., 1, 3], links[..., 2, 3] = a * cos, a * sin, d
    links[..., 3, 3] = 1.0
    return links


def frames_many(model: ArmModel, joints: Array) -> Array:
    """(K, 7, 4, 4): base frame, then the frame of each joint's link, the last being the flange. ``joints`` (K, 6)."""
    links = _link_matrices(model, np.asarray(joints, dtype=np.float64))
    frames = np.empty((len(links), 7, 4, 4))
    frames[:, 0] = np.eye(4)
    for index in range(6):
        frames[:, index + 1] = frames[:, index] @ links[:, index]
    return frames


def forward(model: ArmModel, joints: ArrayLike) -> Pose:
    """``T_base_flange`` at ``joints`` (6,)."""
    matrix = frames_many(model, np.asarray(joints, dtype=np.float64)[None])[0, 6]
    return Pose(matrix[:3, :3].copy(), matrix[:3, 3].copy())


def jacobian_many(model: ArmModel, joints: Array) -> Array:
    """(K, 6, 6) geometric Jacobians of the flange's origin, in base axes: rows m/rad, then rad/rad."""
    frames = frames_many(model, joints)
    axes = frames[:, :6, :3, 2]
    levers = frames[:, 6, None, :3, 3] - frames[:, :6, :3, 3]
    return np.concatenate([np.cross(axes, levers), axes], axis=2).transpose(0, 2, 1)


def jacobian(model: ArmModel, joints: ArrayLike) -> Array:
    """(6, 6) geometric Jacobian of the flange's origin, in base axes."""
    return np.asarray(jacobian_many(model, np.asarray(joints, dtype=np.float64)[None])[0])


def sigma_min_many(model: ArmModel, joints: Array) -> Array:
    """(K,) smallest singular value of the Jacobian, metres and radians taken as equals: 0 at a singularity."""
    return np.asarray(np.linalg.svd(jacobian_many(model, joints), compute_uv=False)[:, -1])


def _inverse_link(model: ArmModel, index: int, angle: Array) -> Array:
    """Inverse of one link's transform for an array of angles, (..., 4, 4)."""
    joints = np.zeros((*angle.shape, 6))
    joints[..., index] = angle
    link = _link_matrices(model, joints)[..., index, :, :]
    inverse = np.zeros_like(link)
    rotation_t = np.swapaxes(link[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation_t
    inverse[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation_t, link[..., :3, 3])
    inverse[..., 3, 3] = 1.0
    return inverse


def _safe_acos(cosine: Array) -> Array:
    """arccos, NaN beyond 1 by more than rounding."""
    beyond = np.abs(cosine) > 1.0 + _COSINE_SLACK
    return np.where(beyond, np.nan, np.arccos(np.clip(cosine, -1.0, 1.0)))


def inverse_many(model: ArmModel, T_base_flange: Array, free_q6: float = 0.0) -> Array:
    """All solutions for poses (K, 4, 4): (K, 8, 6) in (-pi, pi], NaN where a branch has none.

    The branch index is constant along a path that crosses no singularity. ``free_q6`` is what joint 6 is set to where
    the wrist is singular. Closed form by the usual sequence: the wrist centre gives joint 1, its height over the
    arm's plane joint 5, the flange's axes joint 6, and the plane's two links joints 2 to 4.
    """
    T = np.asarray(T_base_flange, dtype=np.float64)[:, None]  # (K, 1, 4, 4)
    signs = np.array([[i, j, k] for i in (1.0, -1.0) for j in (1.0, -1.0) for k in (1.0, -1.0)])
    shoulder, wrist, elbow = signs.T  # (8,)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Joint 1: the wrist's centre lies d4 beside the arm's plane.
        centre = T[..., :3, 3] - model.d6 * T[..., :3, 2]
        radius = np.hypot(centre[..., 0], centre[..., 1])
        q1 = np.arctan2(centre[..., 1], centre[..., 0]) + shoulder * _safe_acos(model.d4 / radius) + np.pi / 2
        s1, c1 = np.sin(q1), np.cos(q1)
        # Joint 5: how far the flange stands off that plane.
        q5 = wrist * _safe_acos((T[..., 0, 3] * s1 - T[..., 1, 3] * c1 - model.d4) / model.d6)
        # Joint 6: direction of the plane's normal in the flange.
        s5 = np.sin(q5)
        along_y = c1 * T[..., 1, 1] - s1 * T[..., 0, 1]
        along_x = s1 * T[..., 0, 0] - c1 * T[..., 1, 0]
        q6 = np.where(np.abs(s5) < _WRIST_SINGULAR, free_q6, np.arctan2(along_y * np.sign(s5), along_x * np.sign(s5)))
        # Joints 2 to 4: two links in the plane, and what is left of the orientation.
        T_1_4 = _inverse_link(model, 0, q1) @ T @ _inverse_link(model, 5, q6) @ _inverse_link(model, 4, q5)
        x, y = T_1_4[..., 0, 3], T_1_4[..., 1, 3]
        q3 = elbow * _safe_acos((x**2 + y**2 - model.a2**2 - model.a3**2) / (2.0 * model.a2 * model.a3))
        q2 = np.arctan2(y, x) - np.arctan2(model.a3 * np.sin(q3), model.a2 + model.a3 * np.cos(q3))
        q4 = np.arctan2(T_1_4[..., 1, 0], T_1_4[..., 0, 0]) - q2 - q3
        joints = np.stack([q1, q2, q3, q4, q5, q6], axis=-1)
        joints = np.pi - np.mod(np.pi - joints, 2.0 * np.pi)
    joints[~np.isfinite(joints).all(axis=-1)] = np.nan
    return joints


def inverse(model: ArmModel, T_base_flange: Pose, free_q6: float = 0.0) -> Array:
    """(n, 6): every solution in (-pi, pi], n from 0 to 8."""
    solutions = inverse_many(model, T_base_flange.matrix[None], free_q6)[0]
    return np.asarray(solutions[np.isfinite(solutions).all(axis=1)])


def nearest_turn(joints: Array, reference: Array, limits: JointLimits) -> Array:
    """``joints`` (..., 6) plus the multiple of 2 pi for each that comes nearest to ``reference`` within ``limits``.

    NaN where a joint has no equivalent inside the limits.
    """
    turn = 2.0 * np.pi
    lowest = np.ceil((limits.lower - 1e-9 - joints) / turn)
    highest = np.floor((limits.upper + 1e-9 - joints) / turn)
    turns = np.clip(np.round((reference - joints) / turn), lowest, highest)
    return np.where(lowest > highest, np.nan, joints + turn * turns)


def nearest_branch(model: ArmModel, T_base_flange: Pose, joints: ArrayLike, limits: JointLimits) -> Array | None:
    """The solution (6,) within ``limits`` whose largest joint travel from ``joints`` is smallest; None without any."""
    seed = np.asarray(joints, dtype=np.float64)
    solutions = nearest_turn(inverse(model, T_base_flange, free_q6=float(seed[5])), seed, limits)
    solutions = solutions[np.isfinite(solutions).all(axis=1)]
    if len(solutions) == 0:
        return None
    return np.asarray(solutions[np.argmin(np.abs(solutions - seed).max(axis=1))])
