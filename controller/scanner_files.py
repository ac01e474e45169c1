"""Scanner descriptions in YAML -> checked values (``drivers.frame_format``). Units in the keys, SI in the values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from drivers import frame_format
from drivers.frame_format import Algorithm, ByteOrder, Scalar
from perception.errors import InputError


class ScannerFileError(InputError):
    """A scanner description cannot be read or does not describe a frame."""

    code: ClassVar[str] = "scanner-file"
    default_remedy: ClassVar[str] = "Compare with config/scanners/wide_xz.yaml."


@dataclass(frozen=True, slots=True)
class ScannerDescription:
    """One scanner: its frame, its line, and what it measures how well."""

    name: str
    title: str
    baud_rate: int
    layout: frame_format.FrameFormat
    profile_rate_hz: float
    exposure_s: float
    range_noise_m: float
    """1 sigma of one measured range, independent from point to point."""
    systematic_m: float
    """1 sigma of the error that neighbouring points share: colour, incidence, calibration."""
    window_m: float
    """Width of the laser line at the usual stand-off."""


def bundled_scanners() -> list[str]:
    """Names of the descriptions that portdock brings."""
    folder = resources.files("config") / "scanners"
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def load_scanner(name_or_path: str) -> ScannerDescription:
    """Read a bundled description by name, or a file. Raises ScannerFileError with the offending key."""
    if name_or_path in bundled_scanners():
        text = (resources.files("config") / "scanners" / f"{name_or_path}.yaml").read_text()
    else:
        text = _read(name_or_path)
    return parse_scanner(text, name_or_path)


def parse_scanner(text: str, source: str) -> ScannerDescription:
    """A description from YAML text; ``source`` names it in errors."""
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ScannerFileError(f"{source} is not YAML: {' '.join(str(error).split())}") from error
    try:
        return _ScannerModel.model_validate(values).description()
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ScannerFileError(f"{source}: {where}: {first['msg']}") from error
    except ValueError as error:
        raise ScannerFileError(f"{source}: {error}") from error


def _read(name_or_path: str) -> str:
    path = Path(name_or_path)
    if not path.is_file():
        known = ", ".join(bundled_scanners())
        raise ScannerFileError(
            f"no scanner description {name_or_path}",
            remedy=f"Give the path of a YAML file or one of the bundled names: {known}.",
        )
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScannerFileError(f"{name_or_path} cannot be read as text: {error}") from error


# --- the file's keys ------------------------------------------------------------------------------------------------


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _hex(value: Any) -> bytes:
    if not isinstance(value, str):
        raise ValueError('bytes are written as a quoted string of hexadecimal pairs, such as "A5 5A"')
    try:
        return bytes.fromhex(value)
    except ValueError as error:
        raise ValueError(f"{value!r} is not a string of hexadecimal pairs") from error


class _FieldModel(_Strict):
    name: str = Field(pattern="^[a-z][a-z0-9_]*$")
    type: Scalar
    const: int | None = None

    def value(self) -> frame_format.Field:
        return frame_format.Field(self.name, self.type, self.const)


class _ScalingModel(_Strict):
    scale_um: float = Field(gt=0, le=1e6)
    offset_mm: float = Field(default=0.0, ge=-1e5, le=1e5)

    def value(self) -> frame_format.Scaling:
        return frame_format.Scaling(self.scale_um * 1e-6, self.offset_mm * 1e-3)


class _PointsModel(_Strict):
    layout: Literal["xz", "z", "polar"]
    count: int = Field(ge=1, le=16384)
    item: list[_FieldModel] = Field(min_length=1)
    x: _ScalingModel | None = None
    z: _ScalingModel | None = None
    range: _ScalingModel | None = None
    invalid: list[int] = []
    x_start_mm: float = 0.0
    x_step_um: float = 0.0
    first_angle: str = ""
    last_angle: str = ""
    angle_unit_deg: float = 0.0
    angle_offset_deg: float = 0.0
    clockwise: bool = True

    def value(self) -> frame_format.PointArray:
        depth = self.range if self.layout == "polar" else self.z
        if depth is None or (self.layout == "xz" and self.x is None):
            raise ValueError(f"points of layout {self.layout} need their scaling: x and z, z, or range")
        if self.layout == "z" and self.x_step_um == 0:
            raise ValueError("points of layout z need x_start_mm and x_step_um")
        if self.layout == "polar" and self.angle_unit_deg == 0:
            raise ValueError("points of layout polar need angle_unit_deg")
        return frame_format.PointArray(
            self.layout,
            self.count,
            tuple(item.value() for item in self.item),
            depth.value(),
            tuple(self.invalid),
            self.x.value() if self.x else frame_format.Scaling(1.0),
            self.x_start_mm * 1e-3,
            self.x_step_um * 1e-6,
            self.first_angle,
            self.last_angle,
            math.radians(self.angle_unit_deg),
            math.radians(self.angle_offset_deg),
            1 if self.clockwise else -1,
        )


class _ChecksumModel(_Strict):
    algorithm: Algorithm
    from_byte: int = Field(default=0, ge=0)
    poly: int | None = None
    init: int | None = None
    xor_out: int | None = None
    reflected: bool | None = None

    def value(self) -> frame_format.Checksum:
        """CRCs without parameters: CRC-8 (SMBus), CRC-16/CCITT-FALSE, CRC-32 of Ethernet."""
        usual = {"crc8": (0x07, 0, 0, False), "crc16": (0x1021, 0xFFFF, 0, False)}
        usual["crc32"] = (0x04C11DB7, 0xFFFFFFFF, 0xFFFFFFFF, True)
        poly, init, xor_out, reflected = usual.get(self.algorithm, (0, 0, 0, False))
        return frame_format.Checksum(
            self.algorithm,
            self.from_byte,
            poly if self.poly is None else self.poly,
            init if self.init is None else self.init,
            xor_out if self.xor_out is None else self.xor_out,
            reflected if self.reflected is None else self.reflected,
        )


class _ClockModel(_Strict):
    field: str
    unit_us: float = Field(gt=0, le=1e6)
    modulus: int = Field(ge=2)


class _SequenceModel(_Strict):
    field: str
    modulus: int = Field(ge=4)


class _CommandModel(_Strict):
    send: Annotated[bytes, Field(min_length=1)]
    ack: bytes = b""

    _hex = field_validator("send", "ack", mode="before")(_hex)

    def value(self) -> frame_format.Command:
        return frame_format.Command(self.send, self.ack)


class _ScannerModel(_Strict):
    name: str
    title: str = ""
    baud_rate: int = Field(ge=300, le=12_000_000)
    profile_rate_hz: float = Field(gt=0, le=10_000)
    exposure_us: float = Field(default=0.0, ge=0, le=1e6)
    range_noise_um: float = Field(ge=0, le=1e6)
    systematic_um: float = Field(default=0.0, ge=0, le=1e6)
    window_mm: float = Field(default=1000.0, gt=0, le=10_000)
    sync: Annotated[bytes, Field(min_length=1)]
    byte_order: ByteOrder
    header: list[_FieldModel] = []
    points: _PointsModel
    trailer: list[_FieldModel] = []
    checksum: _ChecksumModel = _ChecksumModel(algorithm="none")
    clock: _ClockModel | None = None
    sequence: _SequenceModel | None = None
    start: _CommandModel | None = None
    stop: _CommandModel | None = None
    confirmed_by_next: bool = False

    _hex = field_validator("sync", mode="before")(_hex)

    def description(self) -> ScannerDescription:
        clock, sequence = self.clock, self.sequence
        layout = frame_format.FrameFormat(
            self.sync,
            self.byte_order,
            tuple(field.value() for field in self.header),
            self.points.value(),
            tuple(field.value() for field in self.trailer),
            self.checksum.value(),
            frame_format.CounterField(clock.field, clock.modulus, clock.unit_us * 1e-6) if clock else None,
            frame_format.CounterField(sequence.field, sequence.modulus) if sequence else None,
            self.start.value() if self.start else None,
            self.stop.value() if self.stop else None,
            self.confirmed_by_next,
        )
        return ScannerDescription(
            self.name,
            self.title,
            self.baud_rate,
            layout,
            self.profile_rate_hz,
            self.exposure_us * 1e-6,
            self.range_noise_um * 1e-6,
            self.systematic_um * 1e-6,
            self.window_mm * 1e-3,
        )
