"""The RTDE variables that the emulated controller offers: name, type and where the value comes from.

Names and types follow Universal Robots' RTDE guide for PolyScope 5.15. Currents, temperatures and voltages are
constants of a plausible size: the mock simulates no electrics.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mocks.spatial import pose_of
from mocks.ur.state import BITS, REGISTERS

if TYPE_CHECKING:
    from mocks.ur.controller import Controller

Value = float | int | Sequence[float] | np.ndarray
Getter = Callable[["Controller"], Value]

FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
_SCALARS = {"BOOL", "UINT8", "UINT32", "UINT64", "INT32", "DOUBLE"}


def _constant(*values: float) -> Getter:
    fixed: Value = values if len(values) > 1 else values[0]
    return lambda controller: fixed


def _register(bank: str, k: int) -> Getter:
    return lambda controller: getattr(controller.registers, bank)[k]


def _bit(bank: str, k: int) -> Getter:
    return lambda controller: bool(getattr(controller.registers, bank) >> k & 1)


def _outputs() -> dict[str, tuple[str, Getter]]:
    table: dict[str, tuple[str, Getter]] = {}
    for kind, group in _GROUPS:
        table |= {name: (kind, getter) for name, getter in group.items()}
    for k in range(REGISTERS):
        table[f"output_int_register_{k}"] = ("INT32", _register("out_int", k))
        table[f"output_double_register_{k}"] = ("DOUBLE", _register("out_double", k))
        table[f"input_int_register_{k}"] = ("INT32", _register("in_int", k))
        table[f"input_double_register_{k}"] = ("DOUBLE", _register("in_double", k))
    for k in range(BITS):
        table[f"output_bit_register_{k}"] = ("BOOL", _bit("out_bits", k))
        table[f"input_bit_register_{k}"] = ("BOOL", _bit("in_bits", k))
    return table


def _inputs() -> dict[str, str]:
    table = {
        "speed_slider_mask": "UINT32",
        "speed_slider_fraction": "DOUBLE",
        "standard_digital_output_mask": "UINT8",
        "standard_digital_output": "UINT8",
        "configurable_digital_output_mask": "UINT8",
        "configurable_digital_output": "UINT8",
        "tool_digital_output_mask": "UINT8",
        "tool_digital_output": "UINT8",
        "standard_analog_output_mask": "UINT8",
        "standard_analog_output_type": "UINT8",
        "standard_analog_output_0": "DOUBLE",
        "standard_analog_output_1": "DOUBLE",
        "input_bit_registers0_to_31": "UINT32",
        "input_bit_registers32_to_63": "UINT32",
        "external_force_torque": "VECTOR6D",
    }
    table |= {f"input_bit_register_{k}": "BOOL" for k in range(64, BITS)}
    table |= {f"input_int_register_{k}": "INT32" for k in range(REGISTERS)}
    table |= {f"input_double_register_{k}": "DOUBLE" for k in range(REGISTERS)}
    return table


class OutputRecipe:
    """The variables one client asked for, packed in one go."""

    def __init__(self, names: Sequence[str]) -> None:
        self.types = [OUTPUTS[name][0] if name in OUTPUTS else "NOT_FOUND" for name in names]
        self.complete = "NOT_FOUND" not in self.types
        self._getters = [(OUTPUTS[name][1], OUTPUTS[name][0] in _SCALARS) for name in names if name in OUTPUTS]
        self._struct = struct.Struct(">B" + "".join(FORMATS.get(kind, "") for kind in self.types))

    def pack(self, recipe_id: int, controller: Controller) -> bytes:
        """Payload of a data package."""
        values: list[float] = [recipe_id]
        for getter, scalar in self._getters:
            value = getter(controller)
            if scalar:
                values.append(value)  # type: ignore[arg-type]
            elif isinstance(value, np.ndarray):
                values += value.tolist()
            else:
                values.extend(value)  # type: ignore[arg-type]
        return self._struct.pack(*values)


class InputRecipe:
    """The variables one client writes."""

    def __init__(self, names: Sequence[str], taken: frozenset[str]) -> None:
        self.names = list(names)
        self.types = ["IN_USE" if name in taken else INPUTS.get(name, "NOT_FOUND") for name in names]
        self.complete = not {"IN_USE", "NOT_FOUND"} & set(self.types)
        self._structs = [struct.Struct(">" + FORMATS[kind]) for kind in self.types] if self.complete else []
        self.size = sum(one.size for one in self._structs)

    def unpack(self, body: bytes) -> dict[str, tuple[float, ...]]:
        """Values by name; ``body`` has exactly ``size`` bytes."""
        values, offset = {}, 0
        for name, one in zip(self.names, self._structs, strict=True):
            values[name] = one.unpack_from(body, offset)
            offset += one.size
        return values


_GROUPS: list[tuple[str, dict[str, Getter]]] = [
    (
        "DOUBLE",
        {
            "timestamp": lambda c: c.time_s,
            "actual_execution_time": _constant(0.0002),
            "speed_scaling": lambda c: c.arm.scaling,
            "target_speed_fraction": lambda c: c.arm.slider,
            "actual_momentum": lambda c: 12.0 * float(np.linalg.norm(c.tool_speed[:3])),
            "actual_main_voltage": _constant(48.0),
            "actual_robot_voltage": lambda c: 48.0 if c.power.powered else 0.0,
            "actual_robot_current": lambda c: 0.6 if c.power.powered else 0.0,
            "standard_analog_input0": _constant(0.0),
            "standard_analog_input1": _constant(0.0),
            "standard_analog_output0": lambda c: c.io.analog[0],
            "standard_analog_output1": lambda c: c.io.analog[1],
            "io_current": _constant(0.02),
            "euromap67_24V_voltage": _constant(0.0),
            "euromap67_24V_current": _constant(0.0),
            "tool_analog_input0": _constant(0.0),
            "tool_analog_input1": _constant(0.0),
            "tool_output_current": _constant(0.0),
            "tool_temperature": _constant(29.0),
            "tcp_force_scalar": lambda c: float(np.linalg.norm(c.arm.wrench[:3])),
            "payload": lambda c: c.payload.mass_kg,
            "joint_position_deviation_ratio": _constant(0.0),
            "collision_detection_ratio": _constant(0.0),
            "actual_robot_energy_consumed": _constant(0.0),
            "actual_robot_braking_energy_dissipated": _constant(0.0),
        },
    ),
    (
        "VECTOR6D",
        {
            "target_q": lambda c: c.arm.q,
            "target_qd": lambda c: c.arm.qd,
            "target_qdd": lambda c: c.arm.qdd,
            "target_current": _constant(*[0.5] * 6),
            "target_moment": _constant(*[0.0] * 6),
            "actual_q": lambda c: c.arm.q,
            "actual_qd": lambda c: c.arm.qd,
            "actual_current": _constant(*[0.5] * 6),
            "actual_current_window": _constant(*[1.0] * 6),
            "actual_current_as_torque": _constant(*[0.0] * 6),
            "joint_control_output": _constant(*[0.5] * 6),
            "actual_TCP_pose": lambda c: c.tcp_pose,
            "actual_TCP_speed": lambda c: c.tool_speed,
            "actual_TCP_force": lambda c: c.arm.wrench,
            "target_TCP_pose": lambda c: c.tcp_pose,
            "target_TCP_speed": lambda c: c.tool_speed,
            "joint_temperatures": _constant(*[28.0] * 6),
            "actual_joint_voltage": _constant(*[48.0] * 6),
            "payload_inertia": lambda c: c.payload.inertia,
            "ft_raw_wrench": lambda c: c.raw_wrench,
            "wrench_calc_from_currents": lambda c: c.arm.wrench,
            "tcp_offset": lambda c: pose_of(c.arm.reference.T_flange_tcp),
        },
    ),
    (
        "VECTOR3D",
        {
            "actual_tool_accelerometer": _constant(0.0, 0.0, 9.82),
            "elbow_position": lambda c: c.arm.reference.links[1, :3, 3],
            "elbow_velocity": _constant(0.0, 0.0, 0.0),
            "payload_cog": lambda c: c.payload.cog,
        },
    ),
    (
        "UINT64",
        {
            "actual_digital_input_bits": lambda c: c.io.digital_in,
            "actual_digital_output_bits": lambda c: c.io.digital_out,
            "actual_configurable_digital_input_bits": lambda c: c.io.digital_in >> 8 & 0xFF,
            "actual_configurable_digital_output_bits": lambda c: c.io.digital_out >> 8 & 0xFF,
        },
    ),
    (
        "UINT32",
        {
            "runtime_state": lambda c: int(c.runtime_state),
            "robot_status_bits": lambda c: c.robot_status_bits,
            "safety_status_bits": lambda c: c.safety_status_bits,
            "analog_io_types": lambda c: c.io.analog_types,
            "euromap67_input_bits": _constant(0),
            "euromap67_output_bits": _constant(0),
            "tool_mode": _constant(253),
            "tool_analog_input_types": _constant(0),
            "output_bit_registers0_to_31": lambda c: c.registers.out_bits & 0xFFFFFFFF,
            "output_bit_registers32_to_63": lambda c: c.registers.out_bits >> 32 & 0xFFFFFFFF,
            "input_bit_registers0_to_31": lambda c: c.registers.in_bits & 0xFFFFFFFF,
            "input_bit_registers32_to_63": lambda c: c.registers.in_bits >> 32 & 0xFFFFFFFF,
            "script_control_line": _constant(0),
        },
    ),
    (
        "INT32",
        {
            "robot_mode": lambda c: int(c.power.mode),
            "safety_mode": lambda c: int(c.safety.mode),
            "safety_status": lambda c: int(c.safety.mode),
            "tool_output_voltage": _constant(0),
            "time_scale_source": _constant(0),
            "encoder0_raw": _constant(0),
            "encoder1_raw": _constant(0),
        },
    ),
    (
        "UINT8",
        {
            "tool_output_mode": _constant(0),
            "tool_digital_output0_mode": _constant(0),
            "tool_digital_output1_mode": _constant(0),
        },
    ),
    ("VECTOR6INT32", {"joint_mode": lambda c: [253 if c.power.powered else 239] * 6}),
]

OUTPUTS = _outputs()
INPUTS = _inputs()
