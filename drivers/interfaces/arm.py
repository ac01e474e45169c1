"""What an arm offers to the controller, and the values it speaks in."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

from drivers.interfaces.link import LinkHealth
from perception.geometry import Array, Pose


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
    digital_outputs: int = 0
    """Standard digital outputs, bit k for output k."""

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


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """Something solid in the base frame that the arm must keep clear of."""

    name: str
    T_base_box: Pose
    """Pose of the box's centre."""
    half_size: tuple[float, float, float]
    """Half of each edge, m."""
    tool_may_touch: bool = False
    """True for the vehicle's panel, which the plug is meant to meet."""


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

    @property
    def obstacles(self) -> tuple[Box, ...]:
        """What ``set_obstacles`` was told last."""

    def set_obstacles(self, boxes: tuple[Box, ...]) -> None:
        """Boxes seen in the present scene (open cover, panel), to keep clear of beside the configured ones."""

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

    def set_output(self, number: int, level: bool) -> None:
        """Switch a standard digital output, 0 to 7. Raises LinkLostError."""

    def zero_force_sensor(self) -> None:
        """Take the present wrench as zero. Only at rest and out of contact: the caller's duty, checked by the gate."""

    def kick_watchdog(self) -> None:
        """Tell the controller that the supervisor is alive. Only the supervisor's tick calls this."""

    def recover(self) -> None:
        """After an operator's reset: restart the control link with no memory of old motions. Raises LinkOpenError."""
