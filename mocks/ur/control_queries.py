"""Commands of ur_rtde's control script that ask or set something and move nothing, by number."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mocks.spatial import matrix_of, pose_of
from mocks.ur.kinematics import JOINT_LIMIT_RAD
from perception.geometry import Array

if TYPE_CHECKING:
    from mocks.ur.control_script import ControlScript

Query = Callable[["ControlScript"], None]


def _zero_force_sensor(script: ControlScript) -> None:
    script.arm.sensor.zero()


def _set_payload(script: ControlScript) -> None:
    payload, values = script.controller.payload, script.numbers(0, 4)
    payload.mass_kg = float(values[0])
    if values[1:].any():
        payload.cog = values[1:]


def _set_target_payload(script: ControlScript) -> None:
    _set_payload(script)
    script.controller.payload.inertia = script.numbers(4)


def _set_tcp(script: ControlScript) -> None:
    script.arm.set_tcp(script.pose())


def _get_tcp(script: ControlScript) -> None:
    script.write_numbers(pose_of(script.arm.reference.T_flange_tcp))


def _force_gain(script: ControlScript) -> None:
    script.arm.force_gain = float(np.clip(script.numbers(0, 1)[0], 0.0, 2.0))


def _tool_contact(script: ControlScript) -> None:
    script.write_integer(1, script.arm.contact_since(script.numbers(0)[:3]))


def _step_time(script: ControlScript) -> None:
    script.write_numbers(np.array([0.002]))


def _joints_history(script: ControlScript) -> None:
    history = script.arm.history
    steps = max(0, script.integer(1))
    script.write_numbers(history[-1 - min(steps, len(history) - 1)] if history else script.arm.q)


def _target_waypoint(script: ControlScript) -> None:
    script.write_numbers(script.controller.tcp_pose)


def _inverse(script: ControlScript) -> None:
    script.write_numbers(script.joints_for(script.pose()))


def _inverse_near(script: ControlScript) -> None:
    script.write_numbers(script.joints_for(script.pose(), script.numbers(6)))


def _inverse_exists(script: ControlScript) -> None:
    script.write_integer(1, int(script.find_joints(script.pose()) is not None))


def _forward(script: ControlScript) -> None:
    script.write_numbers(script.controller.tcp_pose)


def _forward_of(script: ControlScript) -> None:
    flange = script.arm.reference.kinematics.flange(script.numbers(0))
    script.write_numbers(pose_of(flange @ script.pose(6)))


def _flange(script: ControlScript) -> None:
    script.write_numbers(pose_of(script.arm.reference.links[5]))


def _pose_trans(script: ControlScript) -> None:
    script.write_numbers(pose_of(script.pose(0) @ script.pose(6)))


def _pose_is_safe(script: ControlScript) -> None:
    script.write_integer(1, int(script.find_joints(script.pose()) is not None))


def _joints_are_safe(script: ControlScript) -> None:
    script.write_integer(1, int(float(np.abs(script.numbers(0)).max()) <= JOINT_LIMIT_RAD))


def _is_steady(script: ControlScript) -> None:
    script.write_integer(1, int(script.arm.steady))


def _watchdog(script: ControlScript) -> None:
    register = 24 if script.offset == 24 else 0
    script.controller.set_watchdog(f"input_int_register_{register}", float(script.numbers(0, 1)[0]))


def _protective_stop(script: ControlScript) -> None:
    script.controller.protective_stop()


def _read_contact(script: ControlScript) -> None:
    script.write_integer(1, script.contact_step_back)


def _six_zeros(script: ControlScript) -> None:
    script.write_numbers(np.zeros(6))


def _jacobian(script: ControlScript) -> None:
    asked = script.numbers(0, 12)
    reference = script.arm.reference
    links = reference.kinematics.links(asked[:6]) if asked[:6].any() else reference.links
    tool = matrix_of(asked[6:]) if asked[6:].any() else reference.T_flange_tcp
    _write_matrix(script, reference.kinematics.jacobian(links, (links[5] @ tool)[:3, 3]))


def _zero_matrix(script: ControlScript) -> None:
    _write_matrix(script, np.zeros((6, 6)))


def _write_matrix(script: ControlScript, matrix: Array) -> None:
    """Column by column: 24 values in the lower registers, 12 from number 36 on."""
    columns = matrix.T.ravel()
    script.write_numbers(columns[:24])
    registers = script.controller.registers.out_double
    registers[36:48] = [float(value) for value in columns[24:]]


def _nothing(script: ControlScript) -> None:
    """Accepted without effect: what it would change is not simulated."""


def _no_freedrive(script: ControlScript) -> None:
    script.write_integer(1, 0)


QUERIES: dict[int, Query] = {
    8: _zero_force_sensor, 17: _set_payload, 18: _nothing, 19: _nothing, 20: _nothing, 21: _force_gain,
    25: _tool_contact, 26: _step_time, 27: _joints_history, 28: _target_waypoint, 29: _set_tcp,
    30: _inverse_near, 31: _protective_stop, 35: _watchdog, 36: _pose_is_safe, 37: _joints_are_safe,
    38: _six_zeros, 39: _pose_trans, 40: _get_tcp, 43: _forward, 44: _forward_of, 46: _inverse, 47: _is_steady,
    52: _nothing, 53: _nothing, 54: _no_freedrive, 56: _nothing, 57: _nothing, 58: _flange, 59: _nothing,
    60: _inverse_exists, 61: _inverse_exists, 64: _read_contact, 65: _set_target_payload, 66: _nothing,
    67: _zero_matrix, 68: _six_zeros, 69: _six_zeros, 70: _jacobian, 71: _zero_matrix,
}  # fmt: skip
"""Joint torques, mass matrix and the like answer zero: the mock has no dynamics."""
