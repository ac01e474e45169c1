"""The CAN contract as a DBC holds it: its messages, their protection, and values to bytes and back through cantools.

Signal names are the interface. Identifiers, scaling, layout and cycle times come from the DBC, so a supplier's own
file works without a change here as long as it has the signals named below. The pose comes in three classic frames, or
in one CAN FD frame where the DBC has ``RC_DockPose``.
"""

from __future__ import annotations

import importlib.resources
import math
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import cantools

from drivers.charger.contract_check import complaints
from drivers.charger.e2e import FrameProtection, Scheme
from perception.errors import InputError

HEARTBEAT, COMMAND = "RC_Heartbeat", "RC_Command"
POSITION, ROTATION, QUALITY = "RC_DockPos", "RC_DockRot", "RC_DockQuality"
POSE = "RC_DockPose"
STATUS, ELECTRICAL = "CH_Status", "CH_Electrical"

_JUDGEMENT = ("Valid", "Frame", "Method", "RMSE", "Age", "Fitness", "Tolerance")
BEAT_SIGNALS = {
    HEARTBEAT: ("Mode", "State", "Flags", "CycleId"),
    COMMAND: ("Cmd", "CmdSeq", "Arg"),
}
THREE_FRAMES = {
    POSITION: ("PosSeq", "X", "Y", "Z"),
    ROTATION: ("RotSeq", "RX", "RY", "RZ"),
    QUALITY: ("QualSeq", *_JUDGEMENT),
}
ONE_FRAME = {POSE: ("PoseSeq", "X", "Y", "Z", "QW", "QX", "QY", "QZ", *_JUDGEMENT)}
CHARGER_SIGNALS = {
    STATUS: (
        *("State", "PlugLock", "Prox", "Pilot", "ContactorClosed", "DockEnable", "MotionInhibit", "EStop"),
        *("AckSeq", "AckResult", "FaultCode"),
    ),
    ELECTRICAL: ("Voltage", "Current", "TempDC", "SoC"),
}
_HEADER = ("CRC8", "CRC16", "Counter")
_REMEDY = "Give a DBC with the signals that docs/can.md lists, or leave `dbc` out for the bundled one."


def bundled_dbc(name: str = "portdock.dbc") -> Path:
    """Path of a DBC that comes with portdock: ``portdock.dbc``, or ``portdock_fd.dbc`` for CAN FD."""
    return Path(str(importlib.resources.files("config") / "dbc" / name))


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

    def encode(self, counter: int, **values: float) -> bytes:
        """One protected frame. Raises FrameError for a value that is not finite or out of its signal's range."""
        for name, value in values.items():
            if not math.isfinite(value):
                raise FrameError(f"{self.name}.{name} is not a finite number")
        plain = {name: int(v) if isinstance(v, Integral) else float(v) for name, v in values.items()}  # not numpy's
        try:
            frame: bytes = self.message.encode(self._idle() | plain | self._counted(counter))
        except (cantools.database.errors.EncodeError, OverflowError, ValueError) as error:
            raise FrameError(f"{self.name}: {error}") from error
        return self.protection.seal(frame)

    def encode_raw(self, counter: int, **values: int) -> bytes:
        """One protected frame from raw values, unscaled; what is not given is 0."""
        raw = dict.fromkeys((s.name for s in self.message.signals), 0)
        frame: bytes = self.message.encode(raw | values | self._counted(counter), scaling=False, strict=False)
        return self.protection.seal(frame)

    def unavailable(self, *names: str) -> dict[str, int]:
        """The raw value that says "not available": the most negative of a signed signal, the largest of another."""
        signals = [self.message.get_signal_by_name(name) for name in names]
        return {s.name: -(1 << s.length - 1) if s.is_signed else (1 << s.length) - 1 for s in signals}

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
        shown = [s for s in self.message.signals if s.name not in _HEADER]
        return tuple((s.name, _word(values[s.name], s)) for s in shown)

    @property
    def silences_s(self) -> tuple[float, float]:
        """After how much silence the message is late, and lost: as the file says, else 3 and 5 cycles."""
        attributes = self.message.dbc.attributes if self.message.dbc else {}
        names = (("TimeoutDegradedMs", 3.0), ("TimeoutLostMs", 5.0))
        told_ms = [attributes[name].value if name in attributes else 0 for name, _ in names]
        late_s, lost_s = (ms / 1000.0 or cycles * self.cycle_s for ms, (_, cycles) in zip(told_ms, names, strict=True))
        return min(late_s, lost_s), lost_s

    @property
    def pauses(self) -> bool:
        """Whether it is sent only while there is something to say, so that silence means nothing."""
        return str(self.message.send_type) == "CyclicIfActive"

    def _counted(self, counter: int) -> dict[str, int]:
        used = self.protection.scheme is not Scheme.NONE and any(s.name == "Counter" for s in self.message.signals)
        return {"Counter": counter} if used else {}

    def _idle(self) -> dict[str, float]:
        """What each signal is when nobody says otherwise, those of a supplier's own included."""
        return {s.name: max(0.0, s.minimum or 0.0) if s.initial is None else s.initial for s in self.message.signals}


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
        self.path = dbc or bundled_dbc("portdock_fd.dbc" if scheme is Scheme.P5 else "portdock.dbc")
        database = _load(self.path)
        names = {message.name for message in database.messages}
        self.pose_names = tuple(ONE_FRAME if POSE in names else THREE_FRAMES)
        robot = BEAT_SIGNALS | (ONE_FRAME if POSE in names else THREE_FRAMES)
        _require(self.path, database, scheme, robot | CHARGER_SIGNALS)
        self._codecs = {
            name: _codec(database.get_message_by_name(name), scheme, address)
            for signals, address in ((robot, robot_address), (CHARGER_SIGNALS, charger_address))
            for name in signals
        }

    def __getitem__(self, name: str) -> Codec:
        """The message with this name."""
        return self._codecs[name]

    @property
    def is_fd(self) -> bool:
        """Whether any of its messages needs CAN FD."""
        return any(codec.is_fd for codec in self._codecs.values())

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


def _require(path: Path, database: Any, scheme: Scheme, wanted: dict[str, tuple[str, ...]]) -> None:
    present = {m.name: {s.name for s in m.signals} for m in database.messages}
    missing = [
        f"{message}.{signal}"
        for message, signals in wanted.items()
        for signal in (*_header_of(scheme), *signals)
        if signal not in present.get(message, set())
    ]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}", remedy=_REMEDY)
    wrong = complaints(database, wanted, None if scheme is Scheme.NONE else scheme.counter_modulus)
    if wrong:
        raise InputError(f"{path}: {'; '.join(wrong)}", remedy=_REMEDY)


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
