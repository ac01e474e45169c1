"""Where the TCP truly is, and what the arm has to be told to bring it somewhere: with errors that it does not know of.

A hand-eye calibration estimates them (``perception.calibration.arm_fit``). Everything above this driver speaks of true
poses; the wire and its recording, of the arm's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.arm.kinematics import frames_many, nearest_branch
from drivers.arm.settings import UrSettings
from drivers.base import ArmState
from perception.calibration.arm_errors import Weights, error_jacobian, true_in_told
from perception.geometry import Array, Pose

REUSED_WITHIN_RAD = 1e-3
"""So near in all joints the correction is the same to a micrometre."""


class TruePoses:
    """The corrections of one arm, the last one kept."""

    def __init__(self, settings: UrSettings) -> None:
        self._settings = settings
        self._weights = Weights(load_kg=settings.payload_kg)
        self._last: tuple[Array, Pose] | None = None

    def of(self, told: ArmState) -> ArmState:
        """The sample with its true pose."""
        if self._settings.errors is None:
            return told
        return replace(told, T_base_tcp=told.T_base_tcp @ self._true_in_told_tcp(told.joints))

    def told(self, T_base_tcp: Pose, joints: Array) -> Pose:
        """What the arm is to be told, on the branch nearest to ``joints``. A pose out of reach is left as it is."""
        s = self._settings
        if s.errors is None:
            return T_base_tcp
        there = nearest_branch(s.kinematics, T_base_tcp @ s.T_flange_tcp.inverse(), joints, s.joint_limits)
        return T_base_tcp if there is None else T_base_tcp @ self._true_in_told_tcp(there).inverse()

    def _true_in_told_tcp(self, joints: Array) -> Pose:
        s, last = self._settings, self._last
        assert s.errors is not None, "an arm at its word needs no correction"
        if last is None or float(np.abs(joints - last[0]).max()) > REUSED_WITHIN_RAD:
            moved = true_in_told(frames_many(s.kinematics, joints[None]), s.errors, self._weights)[0]
            last = self._last = joints, s.T_flange_tcp.inverse() @ moved @ s.T_flange_tcp
        return last[1]


def error_jacobians(settings: UrSettings, T_base_flange: tuple[Pose, ...], near: Array) -> Array:
    """(K, 6, 19) how errors would move the true flange at K poses, on the branch nearest to ``near`` (6,) joints.

    :raises ValueError: a pose that the nominal kinematics cannot reach
    """
    joints = [nearest_branch(settings.kinematics, pose, near, settings.joint_limits) for pose in T_base_flange]
    reached = [one for one in joints if one is not None]
    if len(reached) < len(joints):
        raise ValueError("the arm told a pose that its model cannot reach")
    return error_jacobian(frames_many(settings.kinematics, np.stack(reached)), Weights(load_kg=settings.payload_kg))
