"""One calibration as a value and as YAML: pose, covariance, what it was measured with, and a checksum over it all."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from typing import Any, Literal, get_args

import numpy as np
import yaml

from controller.arm_config import ArmErrorsConfig
from perception.calibration.arm_errors import COUNT
from perception.calibration.errors import CalibrationError
from perception.geometry import Array, Pose

Kind = Literal["hand-eye", "tool", "port"]
KINDS: tuple[Kind, ...] = get_args(Kind)
_TOOLS = ("portdock", "numpy", "scipy")


class CalibrationFileError(CalibrationError):
    """A calibration file cannot be used."""

    code = "calibration-file"
    default_remedy = "Calibrate again, or `portdock calibrate restore` an older file."


@dataclass(frozen=True, slots=True)
class DeviceNames:
    """What a calibration belongs to."""

    arm: str
    """The arm's serial number, its address where the site names none."""
    scanner: str
    """The scanner's serial number, its device name where the site names none."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """One calibration."""

    kind: Kind
    pose: Pose
    """``hand-eye``: T_flange_scanner. ``tool``: T_flange_tcp. ``port``: T_port_tcp of the mated plug."""
    covariance: Array
    """(6, 6): metres, then rotation vector in radians; position in the outer frame, rotation in the inner one."""
    devices: DeviceNames
    measured: datetime
    residuals: tuple[tuple[str, float], ...] = ()
    """(name with its unit, value)."""
    port: str | None = None
    """Only of kind ``port``: the port type."""
    latency_ms: float | None = None
    """Only of kind ``hand-eye``: ``scanner.latency_ms`` that goes with it."""
    arm_errors: Array | None = None
    """Only of kind ``hand-eye``: (19,) what the arm does not know of itself (``perception.calibration.arm_errors``);
    None: it was taken at its word."""
    made_with: str | None = None
    """Of kind ``port`` and of a tool that was found by mating: which hand-eye and tool calibrations were in force
    (``basis``). What is measured so cancels their errors, and no others."""
    versions: tuple[tuple[str, str], ...] = ()
    corrects: tuple[str, ...] = ()
    """Checksums of those that this one was made from by a correction for drift, the last one first."""

    @property
    def slot(self) -> str:
        """What it replaces: ``hand-eye``, ``tool``, ``port-ccs2``."""
        return self.kind if self.port is None else f"{self.kind}-{self.port}"

    @property
    def sigma_mm(self) -> float:
        """1 sigma of the position, the three axes together."""
        return 1e3 * float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def sigma_deg(self) -> float:
        """1 sigma of the rotation, the three axes together."""
        return float(np.rad2deg(np.sqrt(np.trace(self.covariance[3:, 3:]))))

    def age_days(self, now: datetime) -> float:
        """Days since it was measured."""
        return (now - self.measured).total_seconds() / 86_400.0


def versions_here() -> tuple[tuple[str, str], ...]:
    """Of what a calibration was calculated with."""
    return tuple((name, metadata.version(name)) for name in _TOOLS)


def to_yaml(calibration: Calibration) -> str:
    """The file's text."""
    values = _values(calibration)
    return yaml.safe_dump(values | {"checksum": _checksum(values)}, sort_keys=False, default_flow_style=None)


def checksum_of(calibration: Calibration) -> str:
    """What its file says in the last line."""
    return _checksum(_values(calibration))


def basis(hand_eye: Calibration | None, tool: Calibration | None) -> str:
    """What names the calibrations that something was measured with."""
    return f"hand-eye {_name(hand_eye)}, tool {_name(tool)}"


def _name(one: Calibration | None) -> str:
    return "none" if one is None else checksum_of(one)[:12]


def fits_basis(made_with: str, hand_eye: Calibration | None, tool: Calibration | None) -> bool:
    """Whether something was measured with these two, or with what they correct: a correction puts back what drifted."""
    corrected = [() if one is None else one.corrects for one in (hand_eye, tool)]
    hand_eyes, tools = [
        (_name(one), *(mark[:12] for mark in more)) for one, more in zip((hand_eye, tool), corrected, strict=True)
    ]
    return made_with in {f"hand-eye {first}, tool {second}" for first in hand_eyes for second in tools}


def from_yaml(text: str, where: str) -> Calibration:
    """The calibration in a file's text. Raises CalibrationFileError: damaged, edited, not a calibration."""
    try:
        values = yaml.safe_load(text)
        said = values.pop("checksum")
        calibration = _calibration(values)
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        problem = str(error).replace("\n", " ")
        raise CalibrationFileError(f"{where} is no calibration file: {problem}") from error
    if said != _checksum(values):
        raise CalibrationFileError(f"{where} does not fit its checksum: it was damaged or edited")
    return calibration


def _values(c: Calibration) -> dict[str, Any]:
    more: dict[str, Any] = {"corrects": list(c.corrects)} if c.corrects else {}
    if c.arm_errors is not None:
        more["arm_errors"] = _errors_values(c.arm_errors)
    return more | {
        "kind": c.kind,
        "port": c.port,
        "measured": c.measured.astimezone(UTC).isoformat(timespec="seconds"),
        "made_with": c.made_with,
        "devices": {"arm": c.devices.arm, "scanner": c.devices.scanner},
        "versions": dict(c.versions),
        "pose": {
            "xyz_mm": [round(1e3 * float(v), 6) for v in c.pose.translation],
            "rotvec_deg": [round(float(v), 7) for v in np.rad2deg(c.pose.rotvec)],
        },
        "latency_ms": None if c.latency_ms is None else round(c.latency_ms, 4),
        "residuals": {name: round(float(value), 6) for name, value in c.residuals},
        "covariance_m_rad": [[float(f"{v:.6e}") for v in row] for row in c.covariance],
    }


def _calibration(values: dict[str, Any]) -> Calibration:
    """Raises KeyError, TypeError, ValueError."""
    kind = values["kind"]
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r} is none of {', '.join(KINDS)}")
    if (kind == "port") != isinstance(values["port"], str):
        raise ValueError("a port's name goes with kind port, and only with it")
    covariance = np.asarray(values["covariance_m_rad"], dtype=np.float64)
    if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        raise ValueError("the covariance is not 6 by 6 finite numbers")
    xyz_mm, rotvec_deg = (_finite_ones(values["pose"][key], 3) for key in ("xyz_mm", "rotvec_deg"))
    latency_ms = values["latency_ms"]
    return Calibration(
        kind=kind,
        pose=Pose.from_rotvec(np.deg2rad(rotvec_deg), xyz_mm / 1e3),
        covariance=covariance,
        devices=DeviceNames(str(values["devices"]["arm"]), str(values["devices"]["scanner"])),
        measured=datetime.fromisoformat(values["measured"]),
        residuals=tuple((str(name), float(value)) for name, value in values["residuals"].items()),
        port=values["port"],
        latency_ms=None if latency_ms is None else _finite(latency_ms),
        arm_errors=None if "arm_errors" not in values else _errors(values["arm_errors"]),
        made_with=values["made_with"],
        versions=tuple((str(name), str(version)) for name, version in values["versions"].items()),
        corrects=tuple(str(mark) for mark in values.get("corrects", ())),
    )


def _errors_values(errors: Array) -> dict[str, Any]:
    """In the units of the site file's section ``arm.errors``."""
    values = ArmErrorsConfig.of(errors).model_dump()
    return {name: np.round(value, 6).tolist() for name, value in values.items()}


def _errors(values: dict[str, Any]) -> Array:
    """(19,). Raises ValueError for what that section refuses."""
    errors = ArmErrorsConfig.model_validate(values).errors
    return np.zeros(COUNT) if errors is None else errors


def _finite_ones(values: Any, count: int) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{count} finite numbers are wanted, not {values!r}")
    return array


def _finite(value: Any) -> float:
    if not math.isfinite(value):
        raise ValueError("a number is not finite")
    return float(value)


def _checksum(values: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
