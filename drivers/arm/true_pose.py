"""Where the TCP truly is, and what the arm has to be told to bring it somewhere: with errors that it does not know of.

A hand-eye calibration estimates them (``perception.calibration.arm_fit``). Everything above this driver speaks of true
poses; the wire and its recording, of the arm's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.arm.errors import UnreachableError
from drivers.arm.kinematics import frames_many, nearest_branch
from drivers.arm.settings import UrSettings
from drivers.base import ArmState
from perception.calibration.arm_errors import Weights, error_jacobian, true_in_told
from perception.geometry import Array, Pose


def true_states(told: list[ArmState], settings: UrSettings) -> list[ArmState]:
    """The samples with their true poses. A minute at 500 Hz is asked for at once: no pose is worked out alone."""
    if settings.errors is None or not told:
        return told
    corrections = _true_in_told_tcp(np.stack([state.joints for state in told]), settings.errors, settings)
    rotations = np.stack([state.T_base_tcp.rotation for state in told])
    places = np.stack([state.T_base_tcp.translation for state in told])
    true_rotations = rotations @ corrections[:, :3, :3]
    true_places = (rotations @ corrections[:, :3, 3:])[:, :, 0] + places
    poses = zip(told, true_rotations, true_places, strict=True)
    return [replace(state, T_base_tcp=Pose(rotation, place)) for state, rotation, place in poses]


def told_pose(T_base_tcp: Pose, joints: Array, settings: UrSettings) -> Pose:
    """What the arm is to be told, on the branch nearest to ``joints`` (6,). A pose out of reach is left as it is."""
    s = settings
    if s.errors is None:
        return T_base_tcp
    there = nearest_branch(s.kinematics, T_base_tcp @ s.T_flange_tcp.inverse(), joints, s.joint_limits)
    if there is None:
        return T_base_tcp
    return T_base_tcp @ Pose.from_matrix(_true_in_told_tcp(there[None], s.errors, s)[0]).inverse()


def _true_in_told_tcp(joints: Array, errors: Array, settings: UrSettings) -> Array:
    """(K, 4, 4): the true TCP in the frame of the told one, at joints (K, 6)."""
    T_flange_tcp, weights = settings.T_flange_tcp, Weights(load_kg=settings.payload_kg)
    moved = true_in_told(frames_many(settings.kinematics, joints), errors, weights)
    return np.asarray(T_flange_tcp.inverse().matrix @ moved @ T_flange_tcp.matrix)


def error_jacobians(settings: UrSettings, T_base_flange: tuple[Pose, ...], near: Array) -> Array:
    """(K, 6, 19) how errors would move the true flange at K poses, on the branch nearest to ``near`` (6,) joints.

    :raises UnreachableError: a pose that the nominal kinematics cannot reach
    """
    joints = [nearest_branch(settings.kinematics, pose, near, settings.joint_limits) for pose in T_base_flange]
    reached = [one for one in joints if one is not None]
    if len(reached) < len(joints):
        raise UnreachableError(f"the arm told a pose that a {settings.model} cannot reach", remedy="Check arm.model.")
    return error_jacobian(frames_many(settings.kinematics, np.stack(reached)), Weights(load_kg=settings.payload_kg))
