"""Typed values to frames and back, through whatever DBC is given."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import (
    ChargerRequest,
    ChargerState,
    DockPose,
    Heartbeat,
    Pilot,
    PlugLock,
    Proximity,
    RequestResult,
)
from drivers.charger import messages
from drivers.charger.contract import Contract, FrameError, bundled_dbc
from drivers.charger.e2e import Scheme
from perception.errors import InputError
from perception.geometry import Pose
from tests.unit.charger_frames import FRAMES

CONTRACT = Contract()
ROTVEC = (1.2345, -2.0001, 0.0001)


def _literal(name: str) -> bytes:
    return bytes.fromhex(FRAMES[name][1])


def _pose(**changes: Any) -> DockPose:
    values: dict[str, Any] = {
        "T_base_port": Pose.from_rotvec(ROTVEC, (0.81235, -0.10410, 0.65505)),
        "rmse_m": 0.000155,
        "fitness": 0.935,
        "tolerance_m": 0.001,
        "measured_at_s": 10.0,
    }
    return DockPose(**values | changes)


def test_a_heartbeat_is_the_literal_frame() -> None:
    beat = Heartbeat(mode=2, state=7, flags=0x01ED, cycle_id=0x1234)
    assert messages.encode_heartbeat(CONTRACT["RC_Heartbeat"], 3, beat) == _literal("RC_Heartbeat")


def test_a_command_is_the_literal_frame() -> None:
    frame = messages.encode_command(CONTRACT["RC_Command"], 14, ChargerRequest.ENABLE_POWER, 256 + 42, 125)
    assert frame == _literal("RC_Command")


def test_a_pose_is_the_three_literal_frames() -> None:
    frames = messages.encode_pose(CONTRACT, 3, 16 + 7, _pose(), now_s=10.38)
    assert frames == [_literal(name) for name in ("RC_DockPos", "RC_DockRot", "RC_DockQuality")]


def test_a_withdrawn_pose_says_so_in_every_field() -> None:
    """Coordinates and age are not available, all else is 0; the group shares one sequence number of four bits."""
    frames = messages.encode_no_pose(CONTRACT, 5, 16 + 2)
    assert [frame[1:] for frame in frames] == [
        bytes.fromhex("25 00 80 00 80 00 80"),
        bytes.fromhex("25 00 80 00 80 00 80"),
        bytes.fromhex("25 00 00 F0 FF 00 00"),
    ]
    names = ("RC_DockPos", "RC_DockRot", "RC_DockQuality")
    assert all(CONTRACT[name].protection.intact(frame) for name, frame in zip(names, frames, strict=True))


def test_a_status_frame_reads_as_its_values() -> None:
    status = messages.decode_status(CONTRACT["CH_Status"], _literal("CH_Status"))
    assert status == messages.StatusFrame(
        state=ChargerState.CHARGING,
        proximity=Proximity.LATCHED,
        pilot=Pilot.C,
        lock=PlugLock.LOCKED,
        contactor_closed=True,
        dock_enable=False,
        motion_inhibit=True,
        estop=False,
        ack_sequence=42,
        ack_result=RequestResult.DONE,
        code=0,
    )


@pytest.mark.parametrize(("octets", "flag"), [("00 00 00 00 00 00 00 00", False), ("00 00 FF FF 00 00 00 00", True)])
def test_each_flag_of_a_status_is_read(octets: str, flag: bool) -> None:
    status = messages.decode_status(CONTRACT["CH_Status"], bytes.fromhex(octets))
    assert (status.contactor_closed, status.dock_enable, status.motion_inhibit, status.estop) == (flag,) * 4


@pytest.mark.parametrize(
    ("changes", "alarming"),
    [
        ({}, False),
        ({"estop": True}, True),
        ({"motion_inhibit": True}, True),
        ({"state": ChargerState.FAULT}, True),
        ({"state": ChargerState.ESTOP}, True),
        ({"dock_enable": False, "contactor_closed": False, "code": 3}, False),
    ],
)
def test_what_must_stop_all_motion_is_alarming(changes: dict[str, Any], alarming: bool) -> None:
    calm = replace(messages.decode_status(CONTRACT["CH_Status"], _literal("CH_Status")), motion_inhibit=False)
    assert replace(calm, **changes).alarming is alarming


def test_a_code_is_told_in_the_files_own_word_or_by_its_number() -> None:
    told = [messages.describe_code(CONTRACT["CH_Status"], code) for code in (1, 257, 60_000)]
    assert told == ["EStopPressed", "WrongState", "code 60000"]
    assert messages.FIRST_REJECTION_CODE == 256


def test_a_file_without_words_for_codes_leaves_their_numbers(tmp_path: Path) -> None:
    lines = bundled_dbc().read_text().splitlines(keepends=True)
    path = tmp_path / "wordless.dbc"
    path.write_text("".join(line for line in lines if not (line.startswith("VAL_") and "FaultCode" in line)))
    assert messages.describe_code(Contract(path)["CH_Status"], 1) == "code 1"


def test_an_electrical_frame_reads_as_its_values() -> None:
    electrical = messages.decode_electrical(CONTRACT["CH_Electrical"], _literal("CH_Electrical"))
    assert (electrical.voltage_v, electrical.current_a) == pytest.approx((404.8, -12.5))
    assert (electrical.temperature_c, electrical.charge_percent) == pytest.approx((35.0, 62.5))


def test_raw_values_without_a_meaning_read_as_faults() -> None:
    status = messages.decode_status(CONTRACT["CH_Status"], bytes.fromhex("00 E0 FF 01 00 0F 00 00"))
    assert status.state is ChargerState.FAULT
    assert status.proximity is Proximity.FAULT
    assert status.pilot is Pilot.F
    assert status.lock is PlugLock.FAULT
    assert status.ack_result is RequestResult.FAILED


@pytest.mark.parametrize("length", [0, 1, 7, 9, 64])
def test_a_frame_of_another_length_is_refused(length: int) -> None:
    with pytest.raises(FrameError):
        CONTRACT["CH_Status"].decode(bytes(length))


_METRES = st.floats(-1.638, 1.638)
_ANGLE = st.floats(-1.8, 1.8)


@given(st.tuples(_METRES, _METRES, _METRES), st.tuples(_ANGLE, _ANGLE, _ANGLE))
def test_any_pose_within_range_comes_back_within_half_a_bit(xyz: tuple[float, ...], turn: tuple[float, ...]) -> None:
    pose = Pose.from_rotvec(turn, xyz)
    frames = messages.encode_pose(CONTRACT, 0, 0, _pose(T_base_port=pose), 10.0)
    position, rotation = CONTRACT["RC_DockPos"].decode(frames[0]), CONTRACT["RC_DockRot"].decode(frames[1])
    assert np.abs([position[k] / 1e3 - v for k, v in zip("XYZ", xyz, strict=True)]).max() <= 0.025e-3 + 1e-9
    assert np.abs([rotation["R" + k] - v for k, v in zip("XYZ", pose.rotvec, strict=True)]).max() <= 0.05e-3 + 1e-9


@given(st.integers(0, 15), st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF), st.integers(0, 14))
def test_any_heartbeat_comes_back(mode: int, state: int, flags: int, cycle: int, counter: int) -> None:
    codec = CONTRACT["RC_Heartbeat"]
    frame = messages.encode_heartbeat(codec, counter, Heartbeat(mode, state, flags, cycle))
    values = codec.decode(frame)
    assert [values[k] for k in ("Mode", "State", "Flags", "CycleId", "Counter")] == [mode, state, flags, cycle, counter]
    assert codec.protection.intact(frame)


@given(st.binary(min_size=8, max_size=8))
def test_any_eight_bytes_decode_to_a_status(frame: bytes) -> None:
    messages.decode_status(CONTRACT["CH_Status"], frame)
    assert math.isfinite(messages.decode_electrical(CONTRACT["CH_Electrical"], frame).current_a)


@pytest.mark.parametrize(
    "changes",
    [
        {"T_base_port": Pose(np.eye(3), np.array([math.nan, 0.0, 0.0]))},
        {"T_base_port": Pose(np.eye(3), np.array([0.0, math.inf, 0.0]))},
        {"T_base_port": Pose(np.full((3, 3), math.nan), np.zeros(3))},
        {"T_base_port": Pose(np.eye(3), np.array([0.0, 0.0, 1.639]))},
        {"rmse_m": math.nan},
        {"rmse_m": 0.021},
        {"fitness": 1.01},
        {"fitness": -0.01},
        {"tolerance_m": 0.006},
    ],
)
def test_a_pose_that_does_not_fit_is_refused_not_clamped(changes: dict[str, Any]) -> None:
    with pytest.raises(FrameError):
        messages.encode_pose(CONTRACT, 0, 0, _pose(**changes), 10.0)


@pytest.mark.parametrize(
    ("age_s", "age_ms"),
    [(0.0, 0), (0.38, 380), (4.094, 4094), (4.0944, 4094), (4.0945, 4095), (4.2, 4095), (-1.0, 4095)],
)
def test_an_age_that_does_not_fit_is_not_available(age_s: float, age_ms: int) -> None:
    quality = messages.encode_pose(CONTRACT, 0, 0, _pose(measured_at_s=0.0), age_s)[2]
    assert CONTRACT["RC_DockQuality"].decode(quality)["Age"] == age_ms


def test_the_largest_judgement_comes_through_to_the_last_bit() -> None:
    pose = _pose(rmse_m=0.020, fitness=1.0, tolerance_m=0.005)
    values = CONTRACT["RC_DockQuality"].decode(messages.encode_pose(CONTRACT, 0, 0, pose, 10.0)[2])
    assert [values[k] for k in ("RMSE", "Fitness", "Tolerance")] == pytest.approx([20.0, 100.0, 5.0])


# --- other DBCs -----------------------------------------------------------------------------------------------------


def _variant(folder: Path, *changes: tuple[str, str]) -> Path:
    text = bundled_dbc().read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "supplier.dbc"
    path.write_text(text)
    return path


def test_a_supplier_may_move_and_rescale_signals(tmp_path: Path) -> None:
    path = _variant(
        tmp_path,
        ("SG_ Voltage : 16|16@1+ (0.1,0) [0|6553.5]", "SG_ Voltage : 32|16@1+ (0.5,0) [0|32767.5]"),
        ("SG_ Current : 32|16@1- (0.1,0)", "SG_ Current : 16|16@1- (0.01,0)"),
        ("2566857046", str(0x98FF4056)),
    )
    codec = Contract(path)["CH_Electrical"]
    assert codec.arbitration_id == 0x18FF4056
    electrical = messages.decode_electrical(codec, bytes.fromhex("00 09 E8 03 20 03 55 7D"))
    assert (electrical.voltage_v, electrical.current_a) == pytest.approx((400.0, 10.0))


def test_source_addresses_replace_the_lowest_byte() -> None:
    contract = Contract(robot_address=0x21, charger_address=0x43)
    assert contract["RC_Heartbeat"].arbitration_id == 0x0CFF1021
    assert contract["CH_Status"].arbitration_id == 0x0CFF2043
    assert contract["CH_Status"].protection.data_id == 0xFF20


def test_missing_signals_and_messages_are_named(tmp_path: Path) -> None:
    path = _variant(tmp_path, ("Prox ", "Nearness "), ("RC_Command", "RC_Order"))
    with pytest.raises(InputError) as caught:
        Contract(path)
    assert "CH_Status.Prox" in caught.value.cause
    assert "RC_Command.CmdSeq" in caught.value.cause
    assert "\n" not in caught.value.cause


def test_a_counter_is_asked_for_only_where_it_is_used(tmp_path: Path) -> None:
    path = _variant(tmp_path, ("SG_ Counter :", "SG_ Tick :"))
    with pytest.raises(InputError, match=r"CH_Status\.Counter"):
        Contract(path)
    Contract(path, Scheme.NONE)


def test_the_16_bit_profile_asks_for_its_own_header() -> None:
    with pytest.raises(InputError, match="CRC16"):
        Contract(bundled_dbc(), Scheme.P5)


@pytest.mark.parametrize("text", ["", "not a dbc {", 'VERSION ""\nBO_ 1 A: 8 X\n SG_ a : 0|99@1+ (1,0) [0|1] "" X\n'])
def test_a_broken_file_is_one_line_of_cause(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.dbc"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Contract(path)
    assert "\n" not in caught.value.cause


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no DBC"):
        Contract(tmp_path / "none.dbc")


def test_numpys_numbers_are_numbers_too() -> None:
    codec = CONTRACT["RC_Heartbeat"]
    plain = codec.encode(3, Mode=2, State=7, Flags=0x01ED, CycleId=0x1234)
    assert codec.encode(3, Mode=np.int64(2), State=np.uint8(7), Flags=0x01ED, CycleId=np.float32(0x1234)) == plain
    assert plain == _literal("RC_Heartbeat")
