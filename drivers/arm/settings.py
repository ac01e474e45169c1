"""What has to be known about one arm, as a value."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from drivers.arm.collision import Tool
from drivers.arm.kinematics import MODELS, ArmModel, JointLimits
from drivers.base import Box
from perception.geometry import Array, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """The box, in base axes, that the TCP may be sent to."""

    lower: Array
    """(3,) m."""
    upper: Array
    """(3,) m."""

    def holds(self, position: Array) -> bool:
        """Whether ``position`` (3,) is inside."""
        return bool(np.all((position >= self.lower) & (position <= self.upper)))


@dataclass(frozen=True, slots=True)
class MotionCaps:
    """Largest values that any command may ask for."""

    tcp_speed_m_s: float = 0.5
    tcp_acceleration_m_s2: float = 2.0
    tcp_turn_rad_s: float = 1.0
    joint_speed_rad_s: float = 1.5
    joint_acceleration_rad_s2: float = 3.0
    force_n: float = 150.0
    torque_nm: float = 20.0
    compliant_speed_m_s: float = 0.1
    compliant_turn_rad_s: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class UrSettings:
    """One Universal Robots arm with its tool."""

    host: str
    model: str
    """A key of ``kinematics.MODELS``: ur3e to ur30."""
    T_flange_tcp: Pose
    payload_kg: float
    centre_of_gravity_m: tuple[float, float, float]
    """In the flange frame. Not all zero: the client library would keep the old one."""
    serial: str | None = None
    """Refuse any other robot; None accepts all."""
    frequency_hz: float = 125.0
    """Of both links: 125 or 500."""
    watchdog_hz: float = 5.0
    """The controller stops the program when kicks come less often; the supervisor kicks at 100 Hz."""
    freshness_s: float = 0.2
    """Older state than this is a lost link."""
    connect_timeout_s: float = 1.5
    start_timeout_s: float = 9.0
    """For the control script to run; the library itself gives up after 5 s."""
    upper_registers: bool = False
    """Use RTDE registers 24 and up, where a fieldbus owns the lower ones."""
    stop_running_program: bool = False
    """Whether another program found running may be stopped."""
    patience: float = 1.0
    """Stretches the time limits of the worker process: above 1 only where the host is busy and nothing real moves."""
    joint_limits: JointLimits = field(default_factory=JointLimits.symmetric)
    workspace: Workspace | None = None
    caps: MotionCaps = field(default_factory=MotionCaps)
    least_sigma: float = 0.02
    """Straight lines that come closer to a singularity (smallest singular value of the Jacobian) are refused."""
    boxes: tuple[Box, ...] = ()
    """Solid things in the base frame that the arm must keep clear of."""
    tool_radius_m: float = 0.05
    """Of a capsule around what carries the plug, from the flange to where the plug begins."""
    plug_radius_m: float = 0.035
    plug_length_m: float = 0.06
    """The plug: the last part of the tool before the TCP, as a narrower capsule."""
    least_clearance_m: float = 0.0
    """Between capsules that are generous already."""
    errors: Array | None = None
    """(19,) what the arm does not know of itself (``perception.calibration.arm_errors``); None: taken at its word."""

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(f"unknown arm model {self.model}; known: {', '.join(MODELS)}")

    @property
    def tool(self) -> Tool:
        """The tool's capsules."""
        x, y, z = self.T_flange_tcp.translation.tolist()
        return Tool((x, y, z), self.tool_radius_m, self.plug_length_m, self.plug_radius_m)

    @property
    def kinematics(self) -> ArmModel:
        """The model's nominal lengths."""
        return MODELS[self.model]
