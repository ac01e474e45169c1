"""The emulated controller's RTDE port, byte by byte, without sockets."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocks.ur.controller import Controller
from mocks.ur.rtde_server import Ownership, RtdeClient
from mocks.ur.rtde_variables import INPUTS, OUTPUTS
from tests.unit.mock_ur_parts import Wire, new_controller


def _client(controller: Controller, ownership: Ownership | None = None) -> tuple[RtdeClient, Wire]:
    wire = Wire()
    return RtdeClient(wire, controller, ownership or Ownership(), 500.0), wire  # type: ignore[arg-type]


def _ask(client: RtdeClient, wire: Wire, data: bytes) -> bytes:
    client.received(data)
    return wire.take()


V2 = b"\x00\x05V\x00\x02"


def test_version_2_is_accepted_and_version_3_is_not() -> None:
    client, wire = _client(new_controller())
    assert _ask(client, wire, V2) == b"\x00\x04V\x01"
    assert _ask(client, wire, b"\x00\x05V\x00\x03") == b"\x00\x04V\x00"


def test_controller_version_is_told() -> None:
    client, wire = _client(new_controller((5, 15, 2, 300)))
    assert _ask(client, wire, b"\x00\x03v") == b"\x00\x13v\0\0\0\x05\0\0\0\x0f\0\0\0\x02\0\0\x01\x2c"


def test_output_recipe_with_ur_rtdes_trailing_comma() -> None:
    client, wire = _client(new_controller())
    client.received(V2)
    wire.take()
    body = struct.pack(">d", 125.0) + b"timestamp,robot_mode,actual_q,"
    reply = _ask(client, wire, struct.pack(">HB", 3 + len(body), ord("O")) + body)
    assert reply == b"\x00\x19O\x01DOUBLE,INT32,VECTOR6D"


def test_unknown_output_gives_not_found_and_recipe_0() -> None:
    client, wire = _client(new_controller())
    client.received(V2)
    wire.take()
    reply = _ask(client, wire, b"\x00\x15O" + struct.pack(">d", 1.0) + b"timest,abc")
    assert reply == b"\x00\x17O\x00NOT_FOUND,NOT_FOUND"


def test_version_1_has_no_frequency_and_no_recipe_id() -> None:
    client, wire = _client(new_controller())
    assert _ask(client, wire, b"\x00\x0eOrobot_mode,"[:2] + b"O" + b"robot_mode,") == b"\x00\x08OINT32"


def test_data_package_holds_the_values_in_order() -> None:
    controller = new_controller()
    client, wire = _client(controller)
    client.received(V2 + b"\x00\x2aO" + struct.pack(">d", 500.0) + b"timestamp,runtime_state,payload")
    assert _ask(client, wire, b"\x00\x03S").endswith(b"\x00\x04S\x01")
    controller.payload.mass_kg = 1.5
    controller.tick(0.25)
    client.send_state()
    assert wire.take() == b"\x00\x18U\x01" + struct.pack(">dId", 0.25, 1, 1.5)


def test_samples_come_at_the_frequency_asked_for() -> None:
    controller = new_controller()
    client, wire = _client(controller)
    client.received(V2 + b"\x00\x14O" + struct.pack(">d", 125.0) + b"timestamp" + b"\x00\x03S")
    wire.take()
    for _ in range(500):
        controller.tick(0.002)
        client.send_state()
    stamps = [struct.unpack_from(">d", package, 1)[0] for package in wire.take().split(b"\x00\x0cU")[1:]]
    assert len(stamps) == 125
    assert np.diff(stamps) == pytest.approx(0.008)


def test_nothing_is_sent_before_start_nor_after_pause() -> None:
    controller = new_controller()
    client, wire = _client(controller)
    client.received(V2 + b"\x00\x14O" + struct.pack(">d", 125.0) + b"timestamp")
    wire.take()
    client.send_state()
    assert wire.take() == b""
    client.received(b"\x00\x03S")
    assert _ask(client, wire, b"\x00\x03P") == b"\x00\x04P\x01" or wire.take() == b""
    client.send_state()
    assert wire.take() == b""


def test_a_client_that_does_not_keep_up_misses_samples() -> None:
    controller = new_controller()
    client, wire = _client(controller)
    client.received(V2 + b"\x00\x14O" + struct.pack(">d", 125.0) + b"timestamp" + b"\x00\x03S")
    wire.take()
    wire.backlog = True
    controller.tick(1.0)
    client.send_state()
    assert wire.take() == b""


def _setup_input(names: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(names), ord("I")) + names


def test_input_ids_count_from_1_and_values_reach_the_registers() -> None:
    controller = new_controller()
    client, wire = _client(controller)
    assert (
        _ask(client, wire, _setup_input(b"input_int_register_0,input_double_register_3,"))
        == b"\x00\x10I\x01INT32,DOUBLE"
    )
    assert _ask(client, wire, _setup_input(b"input_int_register_1")) == b"\x00\x09I\x02INT32"
    client.received(b"\x00\x10U\x01" + struct.pack(">id", -7, 0.5))
    client.received(b"\x00\x08U\x02\x00\x00\x00\x2a")
    assert (controller.registers.in_int[:2], controller.registers.in_double[3]) == ([-7, 42], 0.5)


def test_an_input_belongs_to_one_connection_until_it_leaves() -> None:
    controller, ownership = new_controller(), Ownership()
    first, first_wire = _client(controller, ownership)
    second, second_wire = _client(controller, ownership)
    assert _ask(first, first_wire, _setup_input(b"input_int_register_0")) == b"\x00\x09I\x01INT32"
    assert _ask(first, first_wire, _setup_input(b"input_int_register_0")) == b"\x00\x09I\x02INT32"
    assert _ask(second, second_wire, _setup_input(b"input_int_register_0")) == b"\x00\x0aI\x00IN_USE"
    first.closed()
    assert _ask(second, second_wire, _setup_input(b"input_int_register_0")) == b"\x00\x09I\x01INT32"


def test_a_register_of_a_field_bus_is_in_use() -> None:
    ownership = Ownership()
    ownership.reserved = {"input_int_register_0"}
    client, wire = _client(new_controller(), ownership)
    assert _ask(client, wire, _setup_input(b"input_int_register_0")) == b"\x00\x0aI\x00IN_USE"


def test_a_data_package_of_the_wrong_length_is_dropped() -> None:
    controller = new_controller()
    client, wire = _client(controller)
    client.received(_setup_input(b"input_int_register_0,input_double_register_0"))
    client.received(b"\x00\x08U\x01\x00\x00\x00\x2a")
    client.received(b"\x00\x08U\x07\x00\x00\x00\x2a")
    client.received(b"\x00\x03U")
    assert controller.registers.in_int[0] == 0 and not wire.closed


def test_outputs_are_switched_by_mask_only() -> None:
    controller = new_controller()
    client, _ = _client(controller)
    client.received(_setup_input(b"standard_digital_output_mask,standard_digital_output"))
    client.received(_setup_input(b"tool_digital_output_mask,tool_digital_output"))
    client.received(_setup_input(b"speed_slider_mask,speed_slider_fraction"))
    client.received(b"\x00\x06U\x01\x05\xff" + b"\x00\x06U\x02\x02\x02")
    assert controller.io.digital_out == 0b10_0000_0000_0000_0101
    client.received(b"\x00\x06U\x01\x04\x00")
    assert controller.io.digital_out == 0b10_0000_0000_0000_0001
    client.received(b"\x00\x10U\x03" + struct.pack(">Id", 0, 0.1))
    assert controller.arm.slider == 1.0
    client.received(b"\x00\x10U\x03" + struct.pack(">Id", 1, 0.1))
    assert controller.arm.slider == 0.1


@given(st.binary(max_size=200), st.integers(1, 7))
def test_no_bytes_make_the_server_fail(data: bytes, piece: int) -> None:
    client, _ = _client(new_controller())
    for start in range(0, len(data), piece):
        client.received(data[start : start + piece])


@given(st.lists(st.integers(1, 40), max_size=20))
def test_messages_may_arrive_in_any_pieces(cuts: list[int]) -> None:
    client, wire = _client(new_controller())
    stream = V2 + b"\x00\x03v" + _setup_input(b"input_int_register_0,input_int_register_1")
    whole = _ask(*_client(new_controller()), stream)
    for cut in cuts:
        client.received(stream[:cut])
        stream = stream[cut:]
    client.received(stream)
    assert wire.take() == whole


TYPES = {
    "timestamp": "DOUBLE", "target_q": "VECTOR6D", "actual_current_window": "VECTOR6D", "joint_mode": "VECTOR6INT32",
    "robot_mode": "INT32", "safety_mode": "INT32", "safety_status": "INT32", "actual_tool_accelerometer": "VECTOR3D",
    "actual_digital_input_bits": "UINT64", "actual_digital_output_bits": "UINT64", "runtime_state": "UINT32",
    "elbow_position": "VECTOR3D", "elbow_velocity": "VECTOR3D", "robot_status_bits": "UINT32",
    "safety_status_bits": "UINT32", "analog_io_types": "UINT32", "euromap67_input_bits": "UINT32",
    "tool_mode": "UINT32", "tool_output_mode": "UINT8", "tool_analog_input_types": "UINT32",
    "tool_output_voltage": "INT32", "tool_digital_output0_mode": "UINT8", "output_bit_registers0_to_31": "UINT32",
    "output_bit_register_64": "BOOL", "output_bit_register_127": "BOOL", "input_bit_register_64": "BOOL",
    "output_int_register_47": "INT32", "output_double_register_47": "DOUBLE", "input_int_register_47": "INT32",
    "payload": "DOUBLE", "payload_cog": "VECTOR3D", "payload_inertia": "VECTOR6D", "script_control_line": "UINT32",
    "ft_raw_wrench": "VECTOR6D", "joint_position_deviation_ratio": "DOUBLE", "collision_detection_ratio": "DOUBLE",
    "time_scale_source": "INT32", "encoder0_raw": "INT32", "tcp_force_scalar": "DOUBLE",
    "actual_configurable_digital_input_bits": "UINT64", "actual_current_as_torque": "VECTOR6D",
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(TYPES))
def test_documented_outputs_have_their_documented_type(name: str) -> None:
    assert OUTPUTS[name][0] == TYPES[name]


def test_every_output_can_be_packed() -> None:
    controller = new_controller()
    controller.tick(0.002)
    names = ",".join(OUTPUTS)
    client, wire = _client(controller)
    client.received(V2 + struct.pack(">HBd", 11 + len(names), ord("O"), 500.0) + names.encode() + b"\x00\x03S")
    assert b"NOT_FOUND" not in wire.take()
    client.send_state()
    assert struct.unpack_from(">HB", wire.take())[1] == ord("U")


def test_inputs_hold_all_general_purpose_registers() -> None:
    assert {f"input_{kind}_register_{k}" for kind in ("int", "double") for k in range(48)} <= set(INPUTS)
    assert INPUTS["external_force_torque"] == "VECTOR6D" and INPUTS["speed_slider_mask"] == "UINT32"
