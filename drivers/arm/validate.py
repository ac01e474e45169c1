"""Checks of a command's numbers before it leaves this process: pure.

The client library checks little: a list of the wrong length hangs it for minutes, and a pose out of reach kills the
control script.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from drivers.arm.collision import intrusion
from drivers.arm.errors import CollisionError, InvalidCommandError, UnreachableError
from drivers.arm.kinematics import nearest_branch
from drivers.arm.line_check import check_line
from drivers.arm.settings import UrSettings
from drivers.base import ArmState, Box, Compliance
from perception.geometry import Array, Pose

PATH_STEP_RAD = 0.05


def finite(name: str, values: ArrayLike, count: int) -> Array:
    """``values`` as (count,) finite floats. Raises InvalidCommandError."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (count,):
        raise InvalidCommandError(f"{name} must have {count} values, not shape {array.shape}")
    if not np.isfinite(array).all():
        raise InvalidCommandError(f"{name} holds a value that is not finite")
    return array


def within(name: str, value: float, largest: float, unit: str) -> float:
    """``value`` if it is above 0 and at most ``largest``. Raises InvalidCommandError."""
    if not (math.isfinite(value) and 0.0 < value <= largest * (1 + 1e-9)):
        raise InvalidCommandError(f"{name} {value:g} {unit} is not above 0 and at most {largest:g} {unit}")
    return float(value)


def target(pose: Pose, settings: UrSettings) -> Pose:
    """A target for the TCP: finite and in the workspace."""
    finite("the target pose", pose.vector, 6)
    if settings.workspace is not None and not settings.workspace.holds(pose.translation):
        place = ", ".join(f"{value:.3f}" for value in pose.translation)
        raise InvalidCommandError(f"the target ({place}) m lies outside the workspace")
    return pose


def joint_target(pose: Pose, state: ArmState, settings: UrSettings) -> Array:
    """Nominal joints (6,) for a TCP pose on the branch nearest to the present ones. Raises UnreachableError."""
    T_base_flange = pose @ settings.T_flange_tcp.inverse()
    joints = nearest_branch(settings.kinematics, T_base_flange, state.joints, settings.joint_limits)
    if joints is None:
        raise UnreachableError("the target is out of the arm's reach or joint limits")
    return joints


def joint_path(start: Array, end: Array) -> Array:
    """Joints (K, 6) of a joint motion, in steps of at most ``PATH_STEP_RAD``."""
    count = int(np.ceil(np.abs(end - start).max() / PATH_STEP_RAD)) + 1
    return np.asarray(start + np.linspace(0.0, 1.0, max(count, 2))[:, None] * (end - start))


def line(pose: Pose, state: ArmState, settings: UrSettings) -> Array:
    """Joints (K, 6) along the straight way of the TCP to ``pose``. Raises UnreachableError."""
    flange = settings.T_flange_tcp.inverse()
    check = check_line(
        settings.kinematics,
        state.T_base_tcp @ flange,
        pose @ flange,
        state.joints,
        settings.joint_limits,
        settings.least_sigma,
    )
    if not check.ok:
        raise UnreachableError(f"the straight way to the target is not possible: {'; '.join(check.reasons)}")
    return check.joints


def clear(path: Array, settings: UrSettings, boxes: tuple[Box, ...] = ()) -> None:
    """The arm keeps clear of itself and of boxes along joints (K, 6). Raises CollisionError.

    Bodies that are too near already may move, if that brings them no nearer.
    """
    s = settings
    found = intrusion(s.kinematics, path, s.tool, s.boxes + boxes, s.least_clearance_m)
    if found is not None:
        raise CollisionError(
            f"{found.what} would come within {1000 * found.distance_m:.0f} mm "
            f"(allowed {1000 * s.least_clearance_m:.0f} mm)"
        )


def velocity(values: ArrayLike, settings: UrSettings) -> Array:
    """A TCP velocity (6,) within the caps."""
    v = finite("the velocity", values, 6)
    linear, turn = float(np.linalg.norm(v[:3])), float(np.linalg.norm(v[3:]))
    caps = settings.caps
    if linear > caps.tcp_speed_m_s or turn > caps.tcp_turn_rad_s:
        raise InvalidCommandError(
            f"velocity {linear:.3f} m/s, {turn:.3f} rad/s is above {caps.tcp_speed_m_s:g} m/s, "
            f"{caps.tcp_turn_rad_s:g} rad/s"
        )
    return v


def compliance(wanted: Compliance, settings: UrSettings) -> Compliance:
    """Force mode parameters within the caps: forces, and speeds along compliant axes."""
    finite("the task frame", wanted.T_base_task.vector, 6)
    wrench = finite("the wrench", wanted.wrench, 6)
    limits = finite("the limits of force mode", wanted.limits, 6)
    caps = settings.caps
    if len(wanted.selection) != 6:
        raise InvalidCommandError("force mode needs six axes selected or not")
    if np.linalg.norm(wrench[:3]) > caps.force_n or np.linalg.norm(wrench[3:]) > caps.torque_nm:
        raise InvalidCommandError(f"the wrench is above {caps.force_n:g} N or {caps.torque_nm:g} Nm")
    if (limits <= 0).any():
        raise InvalidCommandError("the limits of force mode must be above 0")
    largest = np.array([caps.compliant_speed_m_s] * 3 + [caps.compliant_turn_rad_s] * 3)
    if (limits > largest)[np.asarray(wanted.selection, dtype=bool)].any():
        raise InvalidCommandError(
            f"a compliant axis may move at most {caps.compliant_speed_m_s:g} m/s or {caps.compliant_turn_rad_s:g} rad/s"
        )
    return wanted
