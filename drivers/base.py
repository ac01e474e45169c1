"""What a scanner, an arm and a charger offer, the values they speak in, and the errors they raise.

The controller knows devices only through these protocols. Drivers decide nothing: they talk to one device each, stamp
what they receive with the host's monotonic clock and hand every byte, frame and sample to a ``ByteSink``.
"""

from __future__ import annotations

import enum
import time
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

from perception.errors import PortdockError
from perception.geometry import Array, Pose
from perception.scan import Profile

# --- errors ---------------------------------------------------------------------------------------------------------


class DriverError(PortdockError):
    """Something between portdock and a device went wrong."""

    code: ClassVar[str] = "driver"
    default_remedy: ClassVar[str] = "Check the device's cable, power and settings."


class LinkOpenError(DriverError):
    """A link could not be opened (exit code 3): no such device, taken, no answer."""

    code = "link-open"
    default_remedy = "Check that the device is connected, powered and named correctly in the configuration."


class LinkLostError(DriverError):
    """A link that was open went silent or broke."""

    code = "link-lost"
    default_remedy = "Check cable and power of the device, then reset."


class ProtocolError(DriverError):
    """A device answered in a way its protocol does not allow."""

    code = "protocol"
    default_remedy = "Check that the configured protocol and baud rate are the device's own."


class CommandRejectedError(DriverError):
    """A device understood a command and refused it, or a command is not valid for this device."""

    code = "command-rejected"
    default_remedy = "See the device's own message above."


# --- time and recording ---------------------------------------------------------------------------------------------


class Clock(Protocol):
    """Monotonic seconds. Injected, so that tests and replays own time."""

    def now_s(self) -> float: ...
    def sleep(self, seconds: float) -> None: ...


class MonotonicClock:
    """The host's monotonic clock."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


Direction = Literal["rx", "tx"]


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One CAN frame as it was on the wire."""

    time_s: float
    direction: Direction
    arbitration_id: int
    data: bytes
    is_extended: bool = True
    is_error: bool = False
    is_fd: bool = False


@dataclass(frozen=True, slots=True)
class ArmCommandRecord:
    """One call to the arm with its arguments and result, as ur_rtde keeps its socket to itself."""

    time_s: float
    name: str
    arguments: tuple[float, ...]
    result: str


class ByteSink(Protocol):
    """What a recorder offers to the drivers. Called from reader threads: must be quick and thread-safe."""

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None: ...
    def can_frame(self, frame: CanFrame) -> None: ...
    def arm_state(self, state: ArmState) -> None: ...
    def arm_command(self, record: ArmCommandRecord) -> None: ...


class NullSink:
    """Records nothing."""

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """Drop the bytes."""

    def can_frame(self, frame: CanFrame) -> None:
        """Drop the frame."""

    def arm_state(self, state: ArmState) -> None:
        """Drop the sample."""

    def arm_command(self, record: ArmCommandRecord) -> None:
        """Drop the record."""


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """State of one link, judged by what was received, never by a thread being alive."""

    up: bool
    last_rx_s: float | None
    """Host's monotonic time of the last good data; None before the first."""
    counters: tuple[tuple[str, int], ...] = ()
    """(name, count): bytes, frames, dropped_bytes, bad_checksums, lost, overruns, ..."""
    detail: str = ""


# --- scanner --------------------------------------------------------------------------------------------------------


class Scanner(Protocol):
    """A laser profiler."""

    def open(self) -> None:
        """Open the link and start its reader thread. Raises LinkOpenError."""

    def close(self) -> None:
        """Laser off, link closed. Idempotent."""

    def start(self) -> None:
        """Laser on, profiles flow. Raises LinkLostError."""

    def stop(self) -> None:
        """Laser off. Idempotent."""

    def take(self) -> list[Profile]:
        """Profiles decoded since the last call, oldest first; never blocks. Raises LinkLostError once it is lost."""

    def health(self) -> LinkHealth: ...


# --- arm ------------------------------------------------------------------------------------------------------------


class RobotMode(enum.IntEnum):
    """RTDE ``robot_mode``."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING = 8


class SafetyMode(enum.IntEnum):
    """RTDE ``safety_mode``."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_ESTOP = 6
    ROBOT_ESTOP = 7
    VIOLATION = 8
    FAULT = 9


@dataclass(frozen=True, slots=True, eq=False)
class ArmState:
    """One sample of the arm's state."""

    time_s: float
    """Host's monotonic time at which it was received."""
    device_time_s: float
    """The controller's own time stamp."""
    T_base_tcp: Pose
    T_flange_tcp: Pose
    joints: Array
    """(6,) rad."""
    tcp_speed: Array
    """(6,) m/s and rad/s, base frame."""
    wrench: Array
    """(6,) N and Nm at the TCP in base directions: what the environment does to the tool, payload compensated."""
    mode: RobotMode
    safety: SafetyMode
    moving: bool
    program_running: bool
    speed_scaling: float
    """Speed slider times what the controller makes of it, 0 to 1."""

    @property
    def T_base_flange(self) -> Pose:
        """Pose of the flange."""
        return self.T_base_tcp @ self.T_flange_tcp.inverse()


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """What became of the last motion."""

    motion_id: int
    running: bool
    failed: bool
    detail: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Compliance:
    """UR force mode, type 2, in a frame fixed during the motion."""

    T_base_task: Pose
    selection: tuple[bool, bool, bool, bool, bool, bool]
    """Which axes of the task frame are compliant."""
    wrench: tuple[float, float, float, float, float, float]
    """N and Nm that the arm exerts on the environment along compliant axes."""
    limits: tuple[float, float, float, float, float, float]
    """Compliant axis: largest speed (m/s, rad/s). Other axes: largest deviation (m, rad)."""


class Arm(Protocol):
    """A Universal Robots arm. Motions are asynchronous: they return once accepted, ``motion()`` tells the rest."""

    def open(self) -> None:
        """Connect, verify model, mode and version, set and read back TCP and payload. Raises LinkOpenError."""

    def close(self) -> None:
        """Stop any motion and disconnect. Idempotent."""

    def state(self) -> ArmState:
        """The newest sample. Raises LinkLostError when it is stale by the controller's own time stamp."""

    def history(self, since_s: float) -> list[ArmState]:
        """Samples received after ``since_s`` (host's monotonic), oldest first; a bounded number is kept."""

    def health(self) -> LinkHealth: ...

    def move_joints(self, T_base_tcp: Pose, speed_rad_s: float, acceleration_rad_s2: float) -> int:
        """Joint motion to the pose on the branch nearest to the present joints. Returns the motion's id."""

    def move_linear(self, T_base_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> int:
        """Straight motion to the pose. Returns the motion's id."""

    def move_velocity(self, velocity: Array, acceleration_m_s2: float) -> None:
        """Constant velocity (6,) in base axes until stopped."""

    def comply(self, compliance: Compliance) -> None:
        """Enter force mode, or change its parameters."""

    def stop(self, deceleration_m_s2: float = 1.0) -> None:
        """End whatever motion or mode is active, decelerating. Never raises for an arm at rest."""

    def motion(self) -> MotionProgress: ...

    def zero_force_sensor(self) -> None:
        """Take the present wrench as zero. Only at rest and out of contact: the caller's duty, checked by the gate."""

    def kick_watchdog(self) -> None:
        """Tell the controller that the supervisor is alive. Only the supervisor's tick calls this."""

    def recover(self) -> None:
        """After an operator's reset: restart the control link with no memory of old motions. Raises LinkOpenError."""


# --- charger --------------------------------------------------------------------------------------------------------


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
    electrical_time_s: float
    """Host's monotonic time of the last valid electrical frame; -inf before the first."""


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

    def publish(self, pose: DockPose | None) -> None:
        """Announce an accepted pose with the next heartbeats, or None to send none."""
