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
