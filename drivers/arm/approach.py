"""Whether an arm can follow a whole approach, several straight lines on end, before its first motion is given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.arm.errors import CollisionError
from drivers.arm.line_check import check_line
from drivers.arm.settings import UrSettings
from drivers.arm.validate import clear
from drivers.base import ArmState, Box
from perception.geometry import Pose


def why_not(T_base_tcp: Sequence[Pose], state: ArmState, settings: UrSettings, boxes: tuple[Box, ...]) -> str | None:
    """Why straight lines through TCP poses cannot be followed from ``state``, or None.

    Reach, joint limits and singularities of each line, then clearance of the whole way from the arm itself, from the
    configured boxes and from ``boxes``.
    """
    T_tcp_flange = settings.T_flange_tcp.inverse()
    joints, start = state.joints, state.T_base_tcp @ T_tcp_flange
    path = [joints[None]]
    for pose in T_base_tcp:
        end = pose @ T_tcp_flange
        line = check_line(settings.kinematics, start, end, joints, settings.joint_limits, settings.least_sigma)
        if not line.ok:
            return "; ".join(line.reasons)
        path.append(line.joints)
        joints, start = line.joints[-1], end
    try:
        clear(np.concatenate(path), settings, boxes)
    except CollisionError as error:
        return error.cause
    return None
