"""What a charger offers to the controller, and the values it speaks in."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.interfaces.link import LinkHealth
from drivers.interfaces.recording import CanFrame
from perception.geometry import Pose


class ChargerState(enum.IntEnum):
    """CH_Status.State."""

    INIT = 0
    IDLE = 1
    RESERVED = 2
    READY = 3
    HANDSHAKE = 4
    PRECHARGE = 5
    CHARGING = 6
    STOPPING = 7
    FINISHED = 8
    PAUSED = 9
    FAULT = 10
    ESTOP = 11


class Proximity(enum.IntEnum):
    """CH_Status.Prox: the plug's proximity contact."""

    ABSENT = 0
    INSERTED = 1
    LATCHED = 2
    RELEASE_PRESSED = 3
    FAULT = 4


class Pilot(enum.IntEnum):
    """CH_Status.Pilot: control pilot states A to F of IEC 61851-1."""

    A = 0
    B = 1
    C = 2
    D = 3
    E = 4
    F = 5


class PlugLock(enum.IntEnum):
    """CH_Status.PlugLock."""

    UNLOCKED = 0
    LOCKING = 1
    LOCKED = 2
    UNLOCKING = 3
    FAULT = 4


class ChargerRequest(enum.IntEnum):
    """RC_Command.Cmd."""

    NONE = 0
    RESERVE = 1
    UNLOCK_DOCK = 2
    LOCK_PLUG = 3
    ENABLE_POWER = 4
    STOP_POWER = 5
    UNLOCK_PLUG = 6
    RELEASE = 7
    RESET_FAULT = 8
    ABORT = 15


class RequestResult(enum.IntEnum):
    """CH_Status.AckResult, and what the driver makes of silence."""

    PENDING = 0
    ACCEPTED = 1
    DONE = 2
    REJECTED = 3
    BUSY = 4
    FAILED = 5
    TIMED_OUT = 16


def forbids_motion(state: ChargerState, *, estop: bool, motion_inhibit: bool) -> bool:
    """Whether nothing may move: the charger says so, or is in a state in which nothing may, whatever the bit says."""
    return estop or motion_inhibit or state in (ChargerState.FAULT, ChargerState.ESTOP)


@dataclass(frozen=True, slots=True)
class ChargerStatus:
    """The newest valid frames of the charger."""

    time_s: float
    """Host's monotonic time of the last valid status frame."""
    state: ChargerState
    proximity: Proximity
    pilot: Pilot
    lock: PlugLock
    contactor_closed: bool
    dock_enable: bool
    motion_inhibit: bool
    estop: bool
    fault_code: int
    voltage_v: float
    current_a: float
    """NaN, like the voltage, while no fresh electrical frame says otherwise: no comparison with a limit holds then."""
    electrical_time_s: float
    """Host's monotonic time of the last valid electrical frame; -inf before the first."""

    @property
    def forbids_motion(self) -> bool:
        """See the function of this name."""
        return forbids_motion(self.state, estop=self.estop, motion_inhibit=self.motion_inhibit)


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """RC_Heartbeat, sent by the supervisor's tick and by nothing else."""

    mode: int
    """0 off, 1 dry-run, 2 auto, 3 manual, 4 service, 15 fault."""
    state: int
    """Number of the controller's state."""
    flags: int
    """b0 e-stop ok, b1 protective stop, b2 tool holds plug, b3 in home, b4 clear of vehicle, b5 mated by force,
    b6 scanner ok, b7 RTDE ok, b8 motion active."""
    cycle_id: int


@dataclass(frozen=True, slots=True, eq=False)
class DockPose:
    """The accepted docking pose as the charger is told it (RC_DockPos, RC_DockRot, RC_DockQuality)."""

    T_base_port: Pose
    rmse_m: float
    fitness: float
    """0 to 1."""
    tolerance_m: float
    measured_at_s: float
    """Host's monotonic time of the measurement, for the age."""


class Charger(Protocol):
    """A charger's control unit on CAN."""

    def open(self) -> None:
        """Open the bus and wait for the charger's first valid status. Raises LinkOpenError."""

    def close(self) -> None:
        """Idempotent."""

    def status(self) -> ChargerStatus:
        """The newest valid status. Raises LinkLostError when the charger has been silent beyond its time-out."""

    def health(self) -> LinkHealth: ...

    def heartbeat(self, beat: Heartbeat) -> None:
        """Send one heartbeat, and pose group and pending request when due. Only the supervisor's tick calls this."""

    def request(self, request: ChargerRequest, argument: int = 0) -> int:
        """Start a command hand-shake; returns its sequence number. Resends and times out by itself."""

    def result(self, sequence: int) -> RequestResult:
        """What became of the request with this sequence number."""

    def refusal(self) -> str:
        """The charger's own word for why it refused the newest request; empty when it did not."""

    def alert(self, alarm: Callable[[], None]) -> None:
        """Call this, from any thread, as soon as a valid frame says emergency stop, fault or inhibited motion."""

    def traffic_before_loss(self) -> tuple[CanFrame, ...]:
        """The bus's traffic from 2 s before the newest loss on; empty when the charger was never lost."""

    def publish(self, pose: DockPose | None) -> None:
        """Announce an accepted pose with the next heartbeats, or None to send none."""
