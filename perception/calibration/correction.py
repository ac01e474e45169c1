"""What calibration would have foretold where docks have come to end: the same shift, put into one of three poses.

Docks alone do not tell which of them moved. Any of the three cancels the shift as long as ports are looked at and
docked at as they have been.
"""

from __future__ import annotations

from scipy.spatial.transform import Rotation

from perception.geometry import Array, Pose


def corrected_teaching(T_port_tcp: Pose, shift: Array) -> Pose:
    """The mated plug in the port's frame.

    :param shift: (6,) plug at rest minus expected, in the port frame: metres, then rotation vector in radians
    """
    turn = Rotation.from_rotvec(shift[3:]).as_matrix()
    return Pose(turn @ T_port_tcp.rotation, T_port_tcp.translation + shift[:3])


def corrected_tool(T_flange_tcp: Pose, T_port_tcp: Pose, shift: Array) -> Pose:
    """The tool with which the plug would have rested at ``T_port_tcp``."""
    return T_flange_tcp @ corrected_teaching(T_port_tcp, shift).inverse() @ T_port_tcp


def corrected_hand_eye(T_flange_scanner: Pose, T_scanner_port: Pose, T_port_tcp: Pose, shift: Array) -> Pose:
    """The mounting with which the port would have been located where the plug went.

    :param T_scanner_port: how the scanner looks at ports; between viewpoints it differs by little
    """
    moved = corrected_teaching(T_port_tcp, shift) @ T_port_tcp.inverse()
    return T_flange_scanner @ T_scanner_port @ moved @ T_scanner_port.inverse()
