"""Whether an arm can follow a straight line with its flange from where it stands, before it is told to: pure.

Samples the line, follows one inverse-kinematics branch along it and reports what a controller would only find out on
the way: a part out of reach, a jump between branches, a joint limit, a singularity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from drivers.arm.kinematics import ArmModel, JointLimits, inverse_many, nearest_turn, sigma_min_many
from perception.geometry import Array, Pose

STEP_M = 0.01
STEP_RAD = 0.05
MOST_SAMPLES = 200

JUMP_RAD = 0.6
"""A joint that turns more than this between two samples has left its branch, or passes a singularity."""


@dataclass(frozen=True, slots=True, eq=False)
class LineCheck:
    """What a straight motion of the flange meets. ``ok`` is false if any of the checks failed."""

    ok: bool
    reasons: tuple[str, ...]
    """One phrase for each failed check; empty when ok."""
    reachable: bool
    continuous: bool
    within_limits: bool
    min_sigma: float
    """Smallest singular value of the Jacobian along the line; 0 where a part is out of reach."""
    joints: Array
    """(K, 6) rad along the line, NaN where out of reach."""


def sample_line(start: Pose, end: Pose) -> Array:
    """(K, 4, 4) poses from start to end: straight in translation, slerp in rotation, in steps of 1 cm or 0.05 rad."""
    steps = max(start.distance_to(end) / STEP_M, start.angle_to(end) / STEP_RAD)
    count = int(np.clip(np.ceil(steps) + 1, 2, MOST_SAMPLES))
    share = np.linspace(0.0, 1.0, count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    ends = Rotation.from_matrix(np.stack([start.rotation, end.rotation]))
    poses[:, :3, :3] = Slerp([0.0, 1.0], ends)(share).as_matrix()
    poses[:, :3, 3] = start.translation + share[:, None] * (end.translation - start.translation)
    return poses


def check_line(
    model: ArmModel,
    T_base_flange_start: Pose,
    T_base_flange_end: Pose,
    joints: ArrayLike,
    limits: JointLimits,
    least_sigma: float = 0.02,
) -> LineCheck:
    """Follow the branch nearest to ``joints`` (6,) along the line. Below ``least_sigma`` counts as singular."""
    seed = np.asarray(joints, dtype=np.float64)
    poses = sample_line(T_base_flange_start, T_base_flange_end)
    branches = inverse_many(model, poses, free_q6=float(seed[5]))
    first = nearest_turn(branches[0], seed, JointLimits.symmetric(4.0 * np.pi))
    travel = np.abs(first - seed).max(axis=1)
    if np.isnan(travel).all():
        return _unreachable(len(poses), "the start of the line is out of reach")
    branch = int(np.nanargmin(travel))
    path = np.unwrap(branches[:, branch], axis=0) + (first[branch] - branches[0, branch])
    if np.isnan(path).any():
        share = int(np.isnan(path).any(axis=1).argmax()) / (len(poses) - 1)
        return _unreachable(len(poses), f"the line leaves the arm's reach after {share:.0%} of its length")
    sigmas = sigma_min_many(model, path)
    sigma = float(sigmas.min())
    continuous = bool(np.abs(np.diff(path, axis=0)).max() < JUMP_RAD)
    inside = limits.hold(path)
    reasons = []
    if not continuous:
        reasons.append("the joints would have to jump to another branch on the way")
    if not inside:
        reasons.append(_limit_text(path, limits))
    if sigma < min(least_sigma, 0.9 * float(sigmas[0])):  # out of a singularity is allowed, deeper into it is not
        reasons.append(
            f"the line passes a singularity (smallest singular value {sigma:.3f}, allowed {least_sigma:.3f})"
        )
    return LineCheck(not reasons, tuple(reasons), True, continuous, inside, sigma, path)


def _unreachable(count: int, reason: str) -> LineCheck:
    return LineCheck(False, (reason,), False, False, False, 0.0, np.full((count, 6), np.nan))


def _limit_text(path: Array, limits: JointLimits) -> str:
    excess = np.maximum(path - limits.upper, limits.lower - path).max(axis=0)
    joint = int(np.argmax(excess))
    return f"joint {joint + 1} would leave its range by {np.degrees(excess[joint]):.1f} deg"
