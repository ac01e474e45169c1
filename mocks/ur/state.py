"""What the emulated controller keeps besides the arm: registers, inputs and outputs, power, safety, payload."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from perception.geometry import Array


class RuntimeState(enum.IntEnum):
    """State of the program, RTDE ``runtime_state``."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class PowerMode(enum.IntEnum):
    """RTDE ``robot_mode``."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class Safety(enum.IntEnum):
    """RTDE ``safety_mode``; the names are those of the dashboard."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


SAFETY_BITS = {
    Safety.NORMAL: 0x001,
    Safety.REDUCED: 0x002,
    Safety.PROTECTIVE_STOP: 0x404,
    Safety.RECOVERY: 0x008,
    Safety.SAFEGUARD_STOP: 0x410,
    Safety.SYSTEM_EMERGENCY_STOP: 0x4A0,
    Safety.ROBOT_EMERGENCY_STOP: 0x4C0,
    Safety.VIOLATION: 0x500,
    Safety.FAULT: 0x600,
}
"""RTDE ``safety_status_bits`` of each mode; bit 10 says stopped due to safety."""

STOPPED_SAFETY = frozenset(
    {
        Safety.PROTECTIVE_STOP,
        Safety.SAFEGUARD_STOP,
        Safety.SYSTEM_EMERGENCY_STOP,
        Safety.ROBOT_EMERGENCY_STOP,
        Safety.VIOLATION,
        Safety.FAULT,
    }
)
"""In these nothing moves: those with bit 10."""


REGISTERS = 48
"""Integer and double registers each way."""
BITS = 128


@dataclass(slots=True)
class Registers:
    """General purpose registers; the bit registers are kept as one number each way."""

    in_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    in_double: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    out_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    out_double: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    in_bits: int = 0
    out_bits: int = 0


@dataclass(slots=True)
class InputsOutputs:
    """Digital bits 0-7 standard, 8-15 configurable, 16-17 tool; two analog outputs."""

    digital_in: int = 0
    digital_out: int = 0
    analog: list[float] = field(default_factory=lambda: [0.0, 0.0])
    analog_types: int = 0


POWER_STEP_S = 0.3
"""Emulated seconds from one power mode to the next on the way up; a real arm takes some seconds."""


@dataclass(slots=True)
class Power:
    """Arm power: the mode, and the one it is on its way to."""

    mode: PowerMode = PowerMode.RUNNING
    target: PowerMode = PowerMode.RUNNING
    since_s: float = 0.0

    def towards(self, target: PowerMode, time_s: float) -> None:
        """Head for a mode; power drops at once and comes back step by step."""
        self.target, self.since_s = target, time_s
        if target < self.mode:
            self.mode = target

    def tick(self, time_s: float) -> None:
        """Take the next step up when it is time."""
        if self.mode < self.target and time_s - self.since_s >= POWER_STEP_S:
            self.mode = min(mode for mode in PowerMode if mode > self.mode)
            self.since_s = time_s

    @property
    def powered(self) -> bool:
        """Whether the joints have power."""
        return self.mode in (PowerMode.IDLE, PowerMode.RUNNING)


@dataclass(slots=True)
class SafetyState:
    """Safety mode and since when (emulated seconds)."""

    mode: Safety = Safety.NORMAL
    since_s: float = 0.0


@dataclass(slots=True)
class Payload:
    """What the controller was told about the tool."""

    mass_kg: float = 0.0
    cog: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros(6))
