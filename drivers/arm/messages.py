"""What the arm's parent and its worker process say to each other, pickled over a socket pair.

Kept free of numpy: the worker must start fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Vector = tuple[float, ...]

Phase = Literal["idle", "running", "stopping", "done", "failed"]


@dataclass(frozen=True, slots=True)
class Start:
    """First message: open the control link and make the controller ready."""

    host: str
    frequency_hz: float
    upper_registers: bool
    watchdog_hz: float
    tcp: Vector
    """T_flange_tcp as (x, y, z, rx, ry, rz)."""
    payload_kg: float
    centre_of_gravity_m: Vector


@dataclass(frozen=True, slots=True)
class MoveJoints:
    """Joint motion to a pose on the branch of ``near``; the controller's own calibrated inverse refines the joints."""

    motion_id: int
    pose: Vector
    near: Vector
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class MoveLinear:
    """Straight motion to a pose."""

    motion_id: int
    pose: Vector
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class MoveVelocity:
    """Constant velocity in base axes until stopped."""

    velocity: Vector
    acceleration: float


@dataclass(frozen=True, slots=True)
class Comply:
    """Force mode, type 2."""

    task_frame: Vector
    selection: tuple[int, ...]
    wrench: Vector
    limits: Vector


@dataclass(frozen=True, slots=True)
class Stop:
    """End motion and modes; ``tcp_speed`` (m/s) is the present speed, from which the time to stand still follows."""

    deceleration: float
    tcp_speed: float


@dataclass(frozen=True, slots=True)
class ZeroForceSensor:
    """Take the present wrench as zero."""


@dataclass(frozen=True, slots=True)
class Kick:
    """The supervisor is alive. Not answered."""


@dataclass(frozen=True, slots=True)
class Quit:
    """Stop everything, end the script, end the process."""


Command = MoveJoints | MoveLinear | MoveVelocity | Comply | Stop | ZeroForceSensor | Quit


@dataclass(frozen=True, slots=True)
class Request:
    """A command that is answered by a ``Reply`` with the same number."""

    number: int
    command: Command


@dataclass(frozen=True, slots=True)
class Started:
    """The control link is open and the script runs."""

    tcp: Vector
    """T_flange_tcp as read back."""


@dataclass(frozen=True, slots=True)
class StartFailed:
    """The control link could not be opened."""

    reason: str


Refusal = Literal["", "busy", "program-stopped", "no-solution", "refused"]


@dataclass(frozen=True, slots=True)
class Reply:
    """What became of a request: accepted if ``refusal`` is empty."""

    number: int
    refusal: Refusal = ""
    detail: str = ""
    joints: Vector = ()
    """Joint target of an accepted joint motion."""


@dataclass(frozen=True, slots=True)
class Beat:
    """The worker's process is alive; what its main thread is busy with, and for how long."""

    busy_with: str
    busy_for_s: float


@dataclass(frozen=True, slots=True)
class Status:
    """What the control link knows. Sent when it changes."""

    program_running: bool
    motion_id: int
    phase: Phase


@dataclass(frozen=True, slots=True)
class Ended:
    """Last words before the worker ends by itself."""

    reason: str
