"""The DBC in and out: typed values to frames and back, through cantools.

Signal names are the interface. Identifiers, scaling and layout come from the DBC, so a supplier's own file works
without a change here as long as it has the signals named in ``ROBOT_SIGNALS`` and ``CHARGER_SIGNALS``.
"""

from __future__ import annotations

import enum
import importlib.resources
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import cantools
import numpy as np

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
from drivers.charger.e2e import FrameProtection, Scheme
from perception.errors import InputError

HEARTBEAT, COMMAND = "RC_Heartbeat", "RC_Command"
POSITION, ROTATION, QUALITY = "RC_DockPos", "RC_DockRot", "RC_DockQuality"
STATUS, ELECTRICAL = "CH_Status", "CH_Electrical"

ROBOT_SIGNALS = {
    HEARTBEAT: ("Mode", "State", "Flags", "CycleId"),
    COMMAND: ("Cmd", "CmdSeq", "Arg"),
    POSITION: ("PosSeq", "X", "Y", "Z"),
    ROTATION: ("RotSeq", "RX", "RY", "RZ"),
    QUALITY: ("QualSeq", "Valid", "Frame", "Method", "RMSE", "Age", "Fitness", "Tolerance"),
}
CHARGER_SIGNALS = {
    STATUS: (
        *("State", "PlugLock", "Prox", "Pilot", "ContactorClosed", "DockEnable", "MotionInhibit", "EStop"),
        *("AckSeq", "AckResult", "FaultCode"),
    ),
    ELECTRICAL: ("Voltage", "Current", "TempDC", "SoC"),
}

FIRST_REJECTION_CODE = 256
"""FaultCode from here on is the reason of a rejection, below it a fault."""
_AGE_UNKNOWN_MS = 4095
_REMEDY = "Give a DBC with the signals that docs/can.md lists, or leave `dbc` out for the bundled one."

E = TypeVar("E", bound=enum.IntEnum)


def bundled_dbc() -> Path:
    """Path of the DBC that comes with portdock."""
    return Path(str(importlib.resources.files("config") / "dbc" / "portdock.dbc"))


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


@dataclass(frozen=True, slots=True)
class ElectricalFrame:
    """CH_Electrical."""

    voltage_v: float
    current_a: float
    temperature_c: float
    charge_percent: float


class FrameError(ValueError):
    """A frame that does not fit the contract, or values that do not fit a frame."""


@dataclass(frozen=True, slots=True)
class Codec:
    """One message of the contract: values to bytes and back, with its header."""

    name: str
    arbitration_id: int
    is_extended: bool
    is_fd: bool
    length: int
    cycle_s: float
    protection: FrameProtection
    message: Any
    """The cantools message."""

    def encode(self, counter: int, **values: float | str) -> bytes:
        """One protected frame. Raises FrameError for a value that is not finite or out of its signal's range."""
        for name, value in values.items():
            if not isinstance(value, str) and not math.isfinite(value):
                raise FrameError(f"{self.name}.{name} is not a finite number")
        header = dict.fromkeys(self._header_signals(), 0)
        if "Counter" in header and self.protection.scheme is not Scheme.NONE:
            header["Counter"] = counter
        try:
            frame: bytes = self.message.encode(values | header)
        except (cantools.database.errors.EncodeError, OverflowError, ValueError) as error:
            raise FrameError(f"{self.name}: {error}") from error
        return self.protection.seal(frame)

    def decode(self, frame: bytes) -> dict[str, float]:
        """Scaled raw numbers by signal name. Raises FrameError for a frame of another length."""
        if len(frame) != self.length:
            raise FrameError(f"{self.name} has {self.length} bytes, not {len(frame)}")
        try:
            values: dict[str, float] = self.message.decode(frame, decode_choices=False)
        except (cantools.database.errors.DecodeError, ValueError) as error:
            raise FrameError(f"{self.name}: {error}") from error
        return values

    def words(self, frame: bytes) -> tuple[tuple[str, str], ...]:
        """Signal and value in the DBC's words, header left out. For showing, not for deciding."""
        values = self.message.decode(frame)
        shown = [s for s in self.message.signals if s.name not in ("CRC8", "CRC16", "Counter")]
        return tuple((s.name, _word(values[s.name], s)) for s in shown)

    def _header_signals(self) -> list[str]:
        return [s.name for s in self.message.signals if s.name in ("CRC8", "CRC16", "Counter")]


def _word(value: Any, signal: Any) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return f"{text} {signal.unit}" if signal.unit and isinstance(value, int | float) else text


class Contract:
    """The messages of one DBC under one protection scheme."""

    def __init__(
        self,
        dbc: Path | None = None,
        scheme: Scheme = Scheme.P11,
        robot_address: int | None = None,
        charger_address: int | None = None,
    ) -> None:
        """Load a DBC. Raises InputError that names what is missing."""
        self.path = dbc or bundled_dbc()
        database = _load(self.path)
        _require(self.path, database, scheme)
        self._codecs = {
            name: _codec(database.get_message_by_name(name), scheme, address)
            for signals, address in ((ROBOT_SIGNALS, robot_address), (CHARGER_SIGNALS, charger_address))
            for name in signals
        }

    def __getitem__(self, name: str) -> Codec:
        """The message with this name."""
        return self._codecs[name]

    @property
    def codecs(self) -> tuple[Codec, ...]:
        """Every message, the robot's first."""
        return tuple(self._codecs.values())

    @property
    def from_charger(self) -> tuple[Codec, ...]:
        """The charger's messages."""
        return tuple(self._codecs[name] for name in CHARGER_SIGNALS)


def _load(path: Path) -> Any:
    try:
        return cantools.database.load_file(path, database_format="dbc", strict=True)
    except FileNotFoundError:
        raise InputError(f"there is no DBC at {path}", remedy=_REMEDY) from None
    except Exception as error:  # cantools lets its parser's own exceptions through
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is not a usable DBC: {reason}", remedy=_REMEDY) from error


def _header_of(scheme: Scheme) -> tuple[str, ...]:
    if scheme is Scheme.NONE:
        return ()
    return {0: ("Counter",), 1: ("Counter", "CRC8"), 2: ("Counter", "CRC16")}[scheme.crc_bytes]


def _require(path: Path, database: Any, scheme: Scheme) -> None:
    present = {m.name: {s.name for s in m.signals} for m in database.messages}
    missing = [
        f"{message}.{signal}"
        for message, signals in (ROBOT_SIGNALS | CHARGER_SIGNALS).items()
        for signal in (*_header_of(scheme), *signals)
        if signal not in present.get(message, set())
    ]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}", remedy=_REMEDY)


def _codec(message: Any, scheme: Scheme, address: int | None) -> Codec:
    identifier = message.frame_id if address is None else message.frame_id & ~0xFF | address
    return Codec(
        name=message.name,
        arbitration_id=identifier,
        is_extended=message.is_extended_frame,
        is_fd=message.is_fd,
        length=message.length,
        cycle_s=(message.cycle_time or 100) / 1000.0,
        protection=FrameProtection(scheme, _data_id(message), _crc_offset(message, scheme)),
        message=message,
    )


def _data_id(message: Any) -> int:
    """The DBC's E2EDataID, else the 16 bits above the source address: the PGN of an extended identifier."""
    attributes = message.dbc.attributes if message.dbc else {}
    if "E2EDataID" in attributes:
        return int(attributes["E2EDataID"].value)
    return int(message.frame_id >> 8 if message.is_extended_frame else message.frame_id) & 0xFFFF


def _crc_offset(message: Any, scheme: Scheme) -> int:
    if scheme.crc_bytes == 0:
        return 0
    signal = message.get_signal_by_name(_header_of(scheme)[1])
    little = signal.byte_order == "little_endian"
    if not little or signal.start % 8 or signal.length != 8 * scheme.crc_bytes:
        raise InputError(f"{message.name}.{signal.name} must fill whole bytes in Intel order", remedy=_REMEDY)
    return int(signal.start) // 8


# --- robot to charger -----------------------------------------------------------------------------------------------


def encode_heartbeat(codec: Codec, counter: int, beat: Heartbeat) -> bytes:
    """RC_Heartbeat."""
    return codec.encode(
        counter, Mode=beat.mode, State=beat.state, Flags=beat.flags & 0xFFFF, CycleId=beat.cycle_id & 0xFFFF
    )


def encode_command(codec: Codec, counter: int, request: ChargerRequest, sequence: int, argument: int) -> bytes:
    """RC_Command. ``sequence`` is taken modulo 256."""
    return codec.encode(counter, Cmd=int(request), CmdSeq=sequence % 256, Arg=argument)


def encode_pose(contract: Contract, counter: int, sequence: int, pose: DockPose, now_s: float) -> tuple[bytes, ...]:
    """RC_DockPos, RC_DockRot, RC_DockQuality with one sequence number.

    Raises FrameError for a pose that is not finite or does not fit the signals; nothing is ever clamped.
    """
    x, y, z = (float(v) for v in 1e3 * pose.T_base_port.translation)
    if not np.isfinite(pose.T_base_port.rotation).all():
        raise FrameError("the pose's rotation is not finite")
    rx, ry, rz = (float(v) for v in pose.T_base_port.rotvec)
    age_ms = 1e3 * (now_s - pose.measured_at_s)
    quality = {
        "Valid": 1,
        "Frame": 0,
        "Method": 1,
        "RMSE": 1e3 * pose.rmse_m,
        "Age": round(age_ms) if 0 <= age_ms < _AGE_UNKNOWN_MS - 0.5 else _AGE_UNKNOWN_MS,
        "Fitness": 100.0 * pose.fitness,
        "Tolerance": 1e3 * pose.tolerance_m,
    }
    seq = sequence % 16
    return (
        contract[POSITION].encode(counter, PosSeq=seq, X=x, Y=y, Z=z),
        contract[ROTATION].encode(counter, RotSeq=seq, RX=rx, RY=ry, RZ=rz),
        contract[QUALITY].encode(counter, QualSeq=seq, **quality),
    )


def encode_no_pose(contract: Contract, counter: int, sequence: int) -> tuple[bytes, ...]:
    """The pose group that says: there is no pose (Valid = 0, every coordinate not available)."""
    seq, none = sequence % 16, "NotAvailable"
    return (
        contract[POSITION].encode(counter, PosSeq=seq, X=none, Y=none, Z=none),
        contract[ROTATION].encode(counter, RotSeq=seq, RX=none, RY=none, RZ=none),
        contract[QUALITY].encode(
            counter, QualSeq=seq, Valid=0, Frame=0, Method=0, RMSE=0, Age=_AGE_UNKNOWN_MS, Fitness=0, Tolerance=0
        ),
    )


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
