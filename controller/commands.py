"""Every command that portdock can give to a device: small frozen values, checked by the gate before a driver call."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.base import ChargerRequest, Compliance, DockPose
from perception.geometry import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class MoveJoints:
    """Joint motion of the TCP to a pose, in free space."""

    T_base_tcp: Pose
    speed_rad_s: float
    acceleration_rad_s2: float


@dataclass(frozen=True, slots=True, eq=False)
class MoveLinear:
    """Straight motion of the TCP to a pose."""

    T_base_tcp: Pose
    speed_m_s: float
    acceleration_m_s2: float


@dataclass(frozen=True, slots=True, eq=False)
class BackOff:
    """Straight motion out on the approach axis, although the charger is silent: before contact only."""

    T_base_tcp: Pose
    speed_m_s: float
    acceleration_m_s2: float


@dataclass(frozen=True, slots=True, eq=False)
class MoveVelocity:
    """Constant velocity (6,) in base axes, m/s and rad/s, until stopped."""

    velocity: Array
    acceleration_m_s2: float


@dataclass(frozen=True, slots=True, eq=False)
class Comply:
    """Force mode on the port's axis."""

    compliance: Compliance


@dataclass(frozen=True, slots=True)
class StopMotion:
    """End whatever moves."""


@dataclass(frozen=True, slots=True)
class ZeroForce:
    """Take the present wrench as zero."""


@dataclass(frozen=True, slots=True)
class Laser:
    """Laser and profile stream on or off."""

    on: bool


@dataclass(frozen=True, slots=True)
class SetOutput:
    """A standard digital output of the arm's controller: the scanner's trigger."""

    number: int
    level: bool


@dataclass(frozen=True, slots=True)
class AskCharger:
    """One request of the command hand-shake."""

    request: ChargerRequest


@dataclass(frozen=True, slots=True, eq=False)
class Announce:
    """Tell the charger the docking pose, or that there is none."""

    pose: DockPose | None


Motion = MoveJoints | MoveLinear | MoveVelocity | Comply
Command = Motion | BackOff | StopMotion | ZeroForce | Laser | SetOutput | AskCharger | Announce


def described(command: Command) -> str:
    """A command's arguments, short, for log and recording."""
    match command:
        case MoveJoints(target, speed, _):
            return f"to {_millimetres(target)} mm, {speed:.2f} rad/s"
        case MoveLinear(target, speed, _) | BackOff(target, speed, _):
            return f"to {_millimetres(target)} mm, {speed * 1000:.0f} mm/s"
        case MoveVelocity(velocity, _):
            return f"{[round(float(v) * 1000, 1) for v in velocity[:3]]} mm/s"
        case Comply(compliance):
            return f"wrench {[round(w, 1) for w in compliance.wrench]}"
        case Laser(on):
            return "on" if on else "off"
        case SetOutput(number, level):
            return f"{number} {'high' if level else 'low'}"
        case AskCharger(request):
            return request.name
        case Announce(pose):
            return "none" if pose is None else f"{_millimetres(pose.T_base_port)} mm"
        case StopMotion() | ZeroForce():
            return ""


def _millimetres(pose: Pose) -> list[float]:
    return [round(float(v) * 1000, 1) for v in pose.translation]
