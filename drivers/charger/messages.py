"""Typed values to frames of the contract and back."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.base import (
    ChargerRequest,
    ChargerState,
    DockPose,
    Heartbeat,
    Pilot,
    PlugLock,
    Proximity,
    RequestResult,
    forbids_motion,
)
from drivers.charger.contract import POSE, POSITION, QUALITY, ROTATION, Codec, Contract, FrameError

FIRST_REJECTION_CODE = 256
"""FaultCode from here on is the reason of a rejection, below it a fault."""
_AGE_UNKNOWN_MS = 4095

E = TypeVar("E", bound=enum.IntEnum)


@dataclass(frozen=True, slots=True)
class StatusFrame:
    """CH_Status. A raw value without a meaning reads as the fault of its kind."""

    state: ChargerState
    proximity: Proximity
    pilot: Pilot
    lock: PlugLock
    contactor_closed: bool
    dock_enable: bool
    motion_inhibit: bool
    estop: bool
    ack_sequence: int
    ack_result: RequestResult
    code: int

    @property
    def alarming(self) -> bool:
        """Whether whatever moves must stop now."""
        return forbids_motion(self.state, estop=self.estop, motion_inhibit=self.motion_inhibit)


@dataclass(frozen=True, slots=True)
class ElectricalFrame:
    """CH_Electrical."""

    voltage_v: float
    current_a: float
    temperature_c: float
    charge_percent: float


# --- robot to charger -----------------------------------------------------------------------------------------------


def encode_heartbeat(codec: Codec, counter: int, beat: Heartbeat) -> bytes:
    """RC_Heartbeat."""
    return codec.encode(
        counter, Mode=beat.mode, State=beat.state, Flags=beat.flags & 0xFFFF, CycleId=beat.cycle_id & 0xFFFF
    )


def encode_command(codec: Codec, counter: int, request: ChargerRequest, sequence: int, argument: int) -> bytes:
    """RC_Command. ``sequence`` is taken modulo 256."""
    return codec.encode(counter, Cmd=int(request), CmdSeq=sequence % 256, Arg=argument)


def encode_pose(contract: Contract, counter: int, sequence: int, pose: DockPose, now_s: float) -> list[bytes]:
    """The frames of one pose with one sequence number, in the order of ``contract.pose_names``.

    Raises FrameError for a pose that is not finite or does not fit the signals; nothing is ever clamped.
    """
    if not np.isfinite(pose.T_base_port.rotation).all():
        raise FrameError("the pose's rotation is not finite")
    position = dict(zip("XYZ", (float(v) for v in 1e3 * pose.T_base_port.translation), strict=True))
    judgement = _judgement(pose, now_s)
    if POSE in contract.pose_names:
        turn = Rotation.from_matrix(pose.T_base_port.rotation).as_quat(canonical=True)  # x, y, z, w with w >= 0
        quaternion = dict(zip(("QX", "QY", "QZ", "QW"), (float(v) for v in turn), strict=True))
        return [contract[POSE].encode(counter, PoseSeq=sequence % 256, **position, **quaternion, **judgement)]
    rotation = dict(zip(("RX", "RY", "RZ"), (float(v) for v in pose.T_base_port.rotvec), strict=True))
    seq = sequence % 16
    return [
        contract[POSITION].encode(counter, PosSeq=seq, **position),
        contract[ROTATION].encode(counter, RotSeq=seq, **rotation),
        contract[QUALITY].encode(counter, QualSeq=seq, **judgement),
    ]


def _judgement(pose: DockPose, now_s: float) -> dict[str, float]:
    """How good the pose is, in the contract's units; an age that does not fit is not available."""
    age_ms = 1e3 * (now_s - pose.measured_at_s)
    return {
        "Valid": 1,
        "Frame": 0,
        "Method": 1,
        "RMSE": 1e3 * pose.rmse_m,
        "Age": round(age_ms) if 0 <= age_ms < _AGE_UNKNOWN_MS - 0.5 else _AGE_UNKNOWN_MS,
        "Fitness": 100.0 * pose.fitness,
        "Tolerance": 1e3 * pose.tolerance_m,
    }


def encode_no_pose(contract: Contract, counter: int, sequence: int) -> list[bytes]:
    """The group that says: there is no pose. Valid is 0, every coordinate not available."""
    age = {"Age": _AGE_UNKNOWN_MS}
    if POSE in contract.pose_names:
        codec = contract[POSE]
        nothing = codec.unavailable("X", "Y", "Z", "QW", "QX", "QY", "QZ")
        return [codec.encode_raw(counter, PoseSeq=sequence % 256, **nothing, **age)]
    position, rotation, quality = contract[POSITION], contract[ROTATION], contract[QUALITY]
    seq = sequence % 16
    return [
        position.encode_raw(counter, PosSeq=seq, **position.unavailable("X", "Y", "Z")),
        rotation.encode_raw(counter, RotSeq=seq, **rotation.unavailable("RX", "RY", "RZ")),
        quality.encode_raw(counter, QualSeq=seq, **age),
    ]


# --- charger to robot -----------------------------------------------------------------------------------------------


def decode_status(codec: Codec, frame: bytes) -> StatusFrame:
    """CH_Status. Raises FrameError."""
    v = codec.decode(frame)
    return StatusFrame(
        state=_known(ChargerState, v["State"], ChargerState.FAULT),
        proximity=_known(Proximity, v["Prox"], Proximity.FAULT),
        pilot=_known(Pilot, v["Pilot"], Pilot.F),
        lock=_known(PlugLock, v["PlugLock"], PlugLock.FAULT),
        contactor_closed=bool(v["ContactorClosed"]),
        dock_enable=bool(v["DockEnable"]),
        motion_inhibit=bool(v["MotionInhibit"]),
        estop=bool(v["EStop"]),
        ack_sequence=int(v["AckSeq"]),
        ack_result=_known(RequestResult, v["AckResult"], RequestResult.FAILED),
        code=int(v["FaultCode"]),
    )


def decode_electrical(codec: Codec, frame: bytes) -> ElectricalFrame:
    """CH_Electrical. Raises FrameError."""
    v = codec.decode(frame)
    return ElectricalFrame(v["Voltage"], v["Current"], v["TempDC"], v["SoC"])


def describe_code(codec: Codec, code: int) -> str:
    """The DBC's word for a FaultCode, or its number."""
    choices = codec.message.get_signal_by_name("FaultCode").choices or {}
    return str(choices.get(code, f"code {code}"))


def _known(kind: type[E], raw: float, otherwise: E) -> E:
    try:
        return kind(int(raw))
    except ValueError:
        return otherwise
