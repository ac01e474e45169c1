"""Raw records <-> the values the drivers speak in: scanner bytes, CAN frames, arm states.

Poses and times are stored as the float64 they were: what is read back is equal to the last bit, as replays compare.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.recording.protobuf import Field, Layout, read_varint, varint
from drivers.base import ArmState, CanFrame, RobotMode, SafetyMode
from perception.geometry import Pose

SCANNER_BYTES = Layout("portdock.ScannerBytes", (Field("host_time_ns", "time_ns"), Field("data", "bytes")))

CAN_FRAME = Layout(
    "portdock.CanFrame",
    (
        Field("time_s", "double"),
        Field("arbitration_id", "uint"),
        Field("transmitted", "bool"),
        Field("extended", "bool"),
        Field("error", "bool"),
        Field("fd", "bool"),
        Field("data", "bytes"),
    ),
)

ARM_STATE = Layout(
    "portdock.ArmState",
    (
        Field("time_s", "double"),
        Field("device_time_s", "double"),
        Field("base_tcp_translation_m", "doubles", 3),
        Field("base_tcp_rotation", "doubles", 9),
        Field("flange_tcp_translation_m", "doubles", 3),
        Field("flange_tcp_rotation", "doubles", 9),
        Field("joints_rad", "doubles", 6),
        Field("tcp_speed", "doubles", 6),
        Field("wrench", "doubles", 6),
        Field("mode", "int"),
        Field("safety", "int"),
        Field("moving", "bool"),
        Field("program_running", "bool"),
        Field("speed_scaling", "double"),
        Field("digital_outputs", "int"),
    ),
)
_WITHOUT_OUTPUTS = len(ARM_STATE.fields) - 1
"""So many fields have the arm's samples of recordings that were made before outputs were among them."""

_SCANNER_STRUCT, _SCANNER_TAGS = SCANNER_BYTES.struct, SCANNER_BYTES.prefixes
_CAN_STRUCT, _CAN_TAGS = CAN_FRAME.struct, CAN_FRAME.prefixes
_ARM_STRUCT, _ARM_TAGS = ARM_STATE.struct, ARM_STATE.prefixes


def encode_scanner_bytes(host_time_ns: int, data: bytes) -> bytes:
    """One chunk exactly as the serial line gave or took it."""
    head = _SCANNER_STRUCT.pack(_SCANNER_TAGS[0], host_time_ns, _SCANNER_TAGS[1])
    return head + varint(len(data)) + data


def decode_scanner_bytes(record: bytes) -> tuple[int, bytes]:
    """(host's monotonic ns, data). Raises ValueError for anything but a record written here."""
    values, data = _unpack_with_bytes(_SCANNER_STRUCT, _SCANNER_TAGS, record)
    return int(values[0]), data


def encode_can_frame(frame: CanFrame) -> bytes:
    """One CAN frame, error frames too."""
    tags = _CAN_TAGS
    head = _CAN_STRUCT.pack(
        *(tags[0], frame.time_s, tags[1], frame.arbitration_id, tags[2], frame.direction == "tx"),
        *(tags[3], frame.is_extended, tags[4], frame.is_error, tags[5], frame.is_fd, tags[6]),
    )
    return head + varint(len(frame.data)) + frame.data


def decode_can_frame(record: bytes) -> CanFrame:
    """Raises ValueError for anything but a record written here."""
    values, data = _unpack_with_bytes(_CAN_STRUCT, _CAN_TAGS, record)
    time_s, arbitration_id, transmitted, extended, error, fd = values
    return CanFrame(
        time_s=float(time_s),
        direction="tx" if transmitted else "rx",
        arbitration_id=int(arbitration_id),
        data=data,
        is_extended=bool(extended),
        is_error=bool(error),
        is_fd=bool(fd),
    )


def encode_arm_state(state: ArmState) -> bytes:
    """One sample of the arm."""
    tags = _ARM_TAGS
    return _ARM_STRUCT.pack(
        *(tags[0], state.time_s, tags[1], state.device_time_s),
        *(tags[2], *state.T_base_tcp.translation.tolist(), tags[3], *state.T_base_tcp.rotation.ravel().tolist()),
        *(tags[4], *state.T_flange_tcp.translation.tolist(), tags[5], *state.T_flange_tcp.rotation.ravel().tolist()),
        *(tags[6], *state.joints.tolist(), tags[7], *state.tcp_speed.tolist(), tags[8], *state.wrench.tolist()),
        *(tags[9], int(state.mode), tags[10], int(state.safety)),
        *(tags[11], state.moving, tags[12], state.program_running, tags[13], state.speed_scaling),
        *(tags[14], state.digital_outputs),
    )


def arm_table(records: Sequence[bytes]) -> NDArray[np.void]:
    """All samples of a stream as one structured array (N,) with the fields of ``ARM_STATE``; older ones lack outputs.

    Raises ValueError for anything but records written here.
    """
    layouts = {dtype.itemsize: dtype for dtype in (_arm_dtype(_WITHOUT_OUTPUTS), _arm_dtype(len(ARM_STATE.fields)))}
    sizes = {len(record) for record in records} or {_ARM_STRUCT.size}
    if len(sizes) > 1 or not sizes <= layouts.keys():
        raise ValueError("an arm state in the recording has another length than this version writes")
    table = np.frombuffer(b"".join(records), dtype=layouts[sizes.pop()])
    for index, prefix in enumerate(_ARM_TAGS[: len(table.dtype.names or ()) // 2]):
        if (table[f"tag{index}"] != np.frombuffer(prefix, dtype=f"V{len(prefix)}")).any():
            raise ValueError(f"an arm state in the recording lacks {ARM_STATE.fields[index].name}")
    return table


def arm_state(row: NDArray[np.void]) -> ArmState:
    """One row of ``arm_table`` as the driver's value."""
    return ArmState(
        time_s=float(row["time_s"]),
        device_time_s=float(row["device_time_s"]),
        T_base_tcp=Pose(row["base_tcp_rotation"].reshape(3, 3).copy(), row["base_tcp_translation_m"].copy()),
        T_flange_tcp=Pose(row["flange_tcp_rotation"].reshape(3, 3).copy(), row["flange_tcp_translation_m"].copy()),
        joints=row["joints_rad"].copy(),
        tcp_speed=row["tcp_speed"].copy(),
        wrench=row["wrench"].copy(),
        mode=RobotMode(int(row["mode"])),
        safety=SafetyMode(int(row["safety"])),
        moving=bool(row["moving"]),
        program_running=bool(row["program_running"]),
        speed_scaling=float(row["speed_scaling"]),
        digital_outputs=int(row["digital_outputs"]) if "digital_outputs" in (row.dtype.names or ()) else 0,
    )


def _arm_dtype(count: int) -> np.dtype[np.void]:
    """Layout of samples that have the first ``count`` fields."""
    kinds = {"double": "<f8", "int": "<i4", "bool": "?"}
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for index, field in enumerate(ARM_STATE.fields[:count]):
        fields.append((f"tag{index}", f"V{len(_ARM_TAGS[index])}"))
        if field.kind == "doubles":
            fields.append((field.name, "<f8", (field.count,)))
        else:
            fields.append((field.name, kinds[field.kind]))
    return np.dtype(fields)


def _unpack_with_bytes(fixed: Struct, tags: tuple[bytes, ...], record: bytes) -> tuple[tuple[Any, ...], bytes]:
    """Values of the fixed part and the bytes behind it."""
    if len(record) < fixed.size:
        raise ValueError("a record of the recording is cut short")
    parts = fixed.unpack_from(record)
    if parts[0::2] != tags:
        raise ValueError("a record of the recording has other fields than this version writes")
    length, start = read_varint(record, fixed.size)
    if start + length != len(record):
        raise ValueError("a record of the recording has another length than it says")
    return parts[1::2], record[start:]
