"""The emulated controller: power, safety, program and arm, advanced in fixed steps of emulated time.

It knows nothing of sockets: the servers call its methods and read its state.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from mocks.ur.arm import Arm
from mocks.ur.control_script import ControlScript
from mocks.ur.custom_script import CustomScript
from mocks.ur.motion import MotionError
from mocks.ur.program import Program, ScriptError
from mocks.ur.spatial import pose_of
from mocks.ur.state import (
    SAFETY_BITS,
    InputsOutputs,
    Payload,
    Power,
    PowerMode,
    Registers,
    RuntimeState,
    Safety,
    SafetyState,
)
from perception.geometry import Array

log = logging.getLogger(__name__)

UNLOCK_AFTER_S = 5.0
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


class Controller:
    """All state that clients can see, and the step that advances it."""

    def __init__(
        self, arm: Arm, version: tuple[int, int, int, int], max_force_n: float = 250.0, stop_pauses: bool = True
    ) -> None:
        self.arm = arm
        self.version = version
        self.max_force_n = max_force_n
        self.stop_pauses = stop_pauses
        """Whether a protective stop leaves the program PAUSED (play resumes the old motion) or STOPPED."""
        self.time_s = 0.0
        self.registers = Registers()
        self.io = InputsOutputs()
        self.power = Power()
        self.safety = SafetyState()
        self.payload = Payload()
        self.runtime_state = RuntimeState.STOPPED
        self.remote = True
        self.script_starts = True
        self.program: Program | None = None
        self.program_name = ""
        self.watched: str | None = None
        self.watchdog_timeout_s = 0.0
        self.peak_force_n = 0.0
        self._tcp_pose: Array | None = None
        self._tool_speed: Array | None = None
        self.on_kick: Callable[[], None] = lambda: None

    # --- what clients read --------------------------------------------------------------------------------------------

    @property
    def tcp_pose(self) -> Array:
        """Pose vector (6,) of the TCP."""
        if self._tcp_pose is None:
            self._tcp_pose = pose_of(self.arm.reference.T_base_tcp)
        return self._tcp_pose

    @property
    def tool_speed(self) -> Array:
        """TCP speed (6,) in base axes."""
        if self._tool_speed is None:
            self._tool_speed = self.arm.tool_speed()
        return self._tool_speed

    @property
    def robot_status_bits(self) -> int:
        """Bit 0 power on, bit 1 program running."""
        return int(self.power.powered) | (int(self.runtime_state == RuntimeState.PLAYING) << 1)

    @property
    def safety_status_bits(self) -> int:
        """RTDE ``safety_status_bits``."""
        return SAFETY_BITS[self.safety.mode]

    # --- programs -----------------------------------------------------------------------------------------------------

    def run_script(self, text: str) -> bool:
        """Start a script from the script port; ignored without notice in local mode, as on a real one."""
        if not self.remote or not self.script_starts or not self._can_move():
            log.info("script ignored")
            return False
        if self.program is not None:
            self.stop_program()
        control = "def rtde_control" in text or "# int register offset" in text
        program = ControlScript(self, text) if control else CustomScript(self, text)
        self.program, self.program_name = program, program.name
        self.runtime_state = RuntimeState.PLAYING
        self.arm.paused = False
        return True

    def stop_program(self) -> None:
        """End the program and bring the arm to rest."""
        self.program = None
        self.watched = None
        self.runtime_state = RuntimeState.STOPPED
        if self.safety.mode in STOPPED_SAFETY:
            self.arm.stop_dead()
        else:
            self.arm.halt()
            self.arm.paused = False

    def pause_program(self) -> bool:
        """Pause; False without a running program."""
        if self.runtime_state != RuntimeState.PLAYING:
            return False
        self.runtime_state, self.arm.paused = RuntimeState.PAUSED, True
        return True

    def play(self) -> bool:
        """Resume a paused program: the arm continues the old motion. False without one."""
        if self.runtime_state != RuntimeState.PAUSED or not self._can_move():
            return False
        self.runtime_state, self.arm.paused = RuntimeState.PLAYING, False
        return True

    def _can_move(self) -> bool:
        return self.power.mode == PowerMode.RUNNING and self.safety.mode not in STOPPED_SAFETY

    # --- inputs -------------------------------------------------------------------------------------------------------

    def write_inputs(self, values: dict[str, tuple[float, ...]]) -> None:
        """What an RTDE client wrote, by variable name."""
        if self.program is not None and self.runtime_state == RuntimeState.PLAYING:
            self._guarded(self.program, self.program.before_inputs)
        for name, value in values.items():
            if name.startswith("input_int_register_"):
                self.registers.in_int[int(name[19:])] = int(value[0])
            elif name.startswith("input_double_register_"):
                self.registers.in_double[int(name[22:])] = value[0]
            elif name.startswith("input_bit_register"):
                self._write_bits(name, int(value[0]))
        self._write_outputs({name: value[0] for name, value in values.items()})
        if self.watched in values:
            self.on_kick()

    def _write_bits(self, name: str, value: int) -> None:
        if name.startswith("input_bit_registers"):
            first, width = (0, 32) if name.endswith("0_to_31") else (32, 32)
        else:
            first, width = int(name[19:]), 1
        mask = ((1 << width) - 1) << first
        self.registers.in_bits = self.registers.in_bits & ~mask | (value << first) & mask

    def _write_outputs(self, values: dict[str, float]) -> None:
        if int(values.get("speed_slider_mask", 0)) & 1:
            self.arm.slider = float(np.clip(values.get("speed_slider_fraction", 1.0), 0.0, 1.0))
        for name, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = int(values.get(f"{name}_digital_output_mask", 0)) << shift
            bits = int(values.get(f"{name}_digital_output", 0)) << shift
            self.io.digital_out = self.io.digital_out & ~mask | bits & mask
        mask = int(values.get("standard_analog_output_mask", 0))
        for k in (0, 1):
            if mask >> k & 1:
                self.io.analog[k] = values[f"standard_analog_output_{k}"]

    def set_watchdog(self, variable: str, min_frequency_hz: float) -> None:
        """Stop the program when the variable is not written at this rate; 0 switches it off."""
        self.watched = variable if min_frequency_hz > 0.0 else None
        self.watchdog_timeout_s = 1.0 / min_frequency_hz if min_frequency_hz > 0.0 else 0.0
        self.on_kick()

    def watchdog_expired(self) -> None:
        """The watched variable was not written in time."""
        if self.program is not None:
            log.info("watchdog on %s expired: program stopped", self.watched)
            self.stop_program()

    # --- safety -------------------------------------------------------------------------------------------------------

    def protective_stop(self) -> None:
        """Category 2 stop; the program is left paused (or stopped, as configured)."""
        if self.safety.mode in STOPPED_SAFETY:
            return
        self._enter(Safety.PROTECTIVE_STOP)
        if self.stop_pauses and self.runtime_state == RuntimeState.PLAYING:
            self.runtime_state, self.arm.paused = RuntimeState.PAUSED, True
        else:
            self.stop_program()

    def unlock_protective_stop(self) -> bool:
        """Release it; refused within five seconds of the stop."""
        if self.safety.mode != Safety.PROTECTIVE_STOP or self.time_s - self.safety.since_s < UNLOCK_AFTER_S:
            return False
        self._enter(Safety.NORMAL)
        if self.runtime_state == RuntimeState.STOPPED:
            self.arm.paused = False
        return True

    def emergency_stop(self, system: bool = False) -> None:
        """Drop power; the program ends."""
        wanted = Safety.SYSTEM_EMERGENCY_STOP if system else Safety.ROBOT_EMERGENCY_STOP
        if self.safety.mode == wanted:
            return
        self._enter(wanted)
        self.power.mode = PowerMode.POWER_OFF
        self.stop_program()

    def release_emergency_stop(self) -> None:
        """The button is pulled out: power stays off."""
        if self.safety.mode in (Safety.SYSTEM_EMERGENCY_STOP, Safety.ROBOT_EMERGENCY_STOP):
            self._enter(Safety.NORMAL)
            self.arm.paused = False

    def enter_safety(self, mode: Safety) -> None:
        """Put the safety system into a mode that nothing else here leads to (reduced, recovery, violation, fault)."""
        self._enter(mode)
        if mode in STOPPED_SAFETY:
            self.power.mode = PowerMode.POWER_OFF
            self.stop_program()

    def restart_safety(self) -> None:
        """After a safety fault or violation: normal again, without power."""
        self._enter(Safety.NORMAL)
        self.power.mode = PowerMode.POWER_OFF

    def safeguard(self, open_gate: bool) -> None:
        """A safeguard stop holds the arm while the gate is open; the program goes on afterwards."""
        if open_gate and self.safety.mode in (Safety.NORMAL, Safety.REDUCED):
            self._enter(Safety.SAFEGUARD_STOP)
            self.arm.paused = True
        elif not open_gate and self.safety.mode == Safety.SAFEGUARD_STOP:
            self._enter(Safety.NORMAL)
            self.arm.paused = self.runtime_state == RuntimeState.PAUSED

    def _enter(self, mode: Safety) -> None:
        log.info("safety mode %s", mode.name)
        self.safety.mode, self.safety.since_s = mode, self.time_s

    # --- the step -----------------------------------------------------------------------------------------------------

    def tick(self, dt: float) -> None:
        """Advance by ``dt`` of emulated time."""
        self.time_s += dt
        self._forget_pose()
        if self.program is not None and self.runtime_state == RuntimeState.PLAYING:
            self._run_program(self.program)
        try:
            self.arm.step(dt)
        except MotionError as error:
            log.warning("motion ended: %s", error)
            self.stop_program()
        self._forget_pose()
        force_n = float(np.linalg.norm(self.arm.true_wrench[:3]))
        self.peak_force_n = max(self.peak_force_n, force_n)
        if force_n > self.max_force_n:
            self.protective_stop()

    def _forget_pose(self) -> None:
        """Pose and speed are computed when the first client asks after a step."""
        self._tcp_pose = self._tool_speed = None

    def _run_program(self, program: Program) -> None:
        if self._guarded(program, program.tick) is False and self.program is program:
            self.stop_program()

    def _guarded(self, program: Program, step: Callable[[], bool | None]) -> bool | None:
        """Take a step of a program; a run-time error ends it."""
        try:
            return step()
        except (ScriptError, MotionError) as error:
            log.warning("program %s ended: %s", program.name, error)
            self.stop_program()
            return False
