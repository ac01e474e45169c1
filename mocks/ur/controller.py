"""The emulated controller: power, safety, program and arm, advanced in fixed steps of emulated time.

It knows nothing of sockets: the servers call its methods and read its state.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from mocks.spatial import pose_of
from mocks.ur import inputs
from mocks.ur.arm import Arm
from mocks.ur.control_script import ControlScript
from mocks.ur.custom_script import CustomScript
from mocks.ur.motion import MotionError
from mocks.ur.program import Program, ScriptError
from mocks.ur.state import (
    SAFETY_BITS,
    STOPPED_SAFETY,
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
        self.moved_s = 0.0
        """Emulated time at which the arm moved last."""
        self._tcp_pose: Array | None = None
        self._tool_speed: Array | None = None
        self.on_kick: Callable[[], None] = lambda: None
        self.on_program: Callable[[str, str], None] = lambda title, name: None
        self.commands: deque[tuple[float, int]] = deque(maxlen=1000)
        """Host's monotonic time and number of each command seen in the command register."""
        self.kicks: deque[float] = deque(maxlen=10_000)
        """Host's monotonic time of each write of the watched register."""

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
    def raw_wrench(self) -> Array:
        """What the sensor itself reads (6,): flange axes, the payload's weight not taken out."""
        R = self.arm.reference.links[5, :3, :3]
        force = R.T @ (self.arm.wrench[:3] + np.array([0.0, 0.0, -9.82 * self.payload.mass_kg]))
        return np.concatenate([force, R.T @ self.arm.wrench[3:]])

    @property
    def robot_status_bits(self) -> int:
        """Bit 0 power on, bit 1 program running."""
        return int(self.power.powered) | (int(self.runtime_state == RuntimeState.PLAYING) << 1)

    @property
    def safety_status_bits(self) -> int:
        """RTDE ``safety_status_bits``."""
        return SAFETY_BITS[self.safety.mode]

    # --- programs -----------------------------------------------------------------------------------------------------

    def run_script(self, text: str, name: str | None = None) -> bool:
        """Start a script from the script port; ignored without notice in local mode, as on a real one."""
        if not self.remote or not self.script_starts or not self._can_move():
            log.info("script ignored")
            return False
        if self.program is not None:
            self.stop_program()
        control = "def rtde_control" in text or "# int register offset" in text
        program = ControlScript(self, text) if control else CustomScript(self, text)
        self.program, self.program_name = program, name or program.name
        self.runtime_state = RuntimeState.PLAYING
        self.on_program("PROGRAM_XXX_STARTED", program.name)
        self.arm.paused = False
        return True

    def stop_program(self) -> None:
        """End the program and bring the arm to rest."""
        if self.program is not None:
            self.on_program("PROGRAM_XXX_STOPPED", self.program.name)
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

    def power_off(self) -> None:
        """Brakes on, power gone, program ended."""
        self.stop_program()
        self.arm.stop_dead()
        self.power.towards(PowerMode.POWER_OFF, self.time_s)

    def power_up(self, target: PowerMode) -> None:
        """Power on (IDLE) or also release the brakes (RUNNING); not while a safety stop is active."""
        if self.safety.mode not in STOPPED_SAFETY and self.power.mode < target:
            self.power.towards(target, self.time_s)

    def _can_move(self) -> bool:
        return self.power.mode == PowerMode.RUNNING and self.safety.mode not in STOPPED_SAFETY

    # --- inputs -------------------------------------------------------------------------------------------------------

    def write_inputs(self, values: dict[str, tuple[float, ...]]) -> None:
        """What an RTDE client wrote, by variable name."""
        if self.program is not None and self.runtime_state == RuntimeState.PLAYING:
            self._guarded(self.program, self.program.before_inputs)
        for register in (0, 24):
            command = int(values.get(f"input_int_register_{register}", (0,))[0])
            if command not in (0, self.registers.in_int[register]):
                self.commands.append((time.monotonic(), command))
        inputs.write_registers(self.registers, values)
        inputs.write_outputs(self.io, values)
        self.arm.slider = inputs.slider(values, self.arm.slider)
        if self.watched in values:
            self.kicks.append(time.monotonic())
            self.on_kick()

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
        """Release it; refused within five seconds of the stop, without effect when there is none."""
        if self.safety.mode != Safety.PROTECTIVE_STOP:
            return True
        if self.time_s - self.safety.since_s < UNLOCK_AFTER_S:
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
        self.power_off()

    def release_emergency_stop(self) -> None:
        """The button is pulled out: power stays off."""
        if self.safety.mode in (Safety.SYSTEM_EMERGENCY_STOP, Safety.ROBOT_EMERGENCY_STOP):
            self._enter(Safety.NORMAL)
            self.arm.paused = False

    def enter_safety(self, mode: Safety) -> None:
        """Put the safety system into a mode that nothing else here leads to (reduced, recovery, violation, fault)."""
        self._enter(mode)
        if mode in STOPPED_SAFETY:
            self.power_off()

    def restart_safety(self) -> None:
        """After a safety fault or violation: normal again, without power."""
        self._enter(Safety.NORMAL)
        self.power_off()
        self.arm.paused = False

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
        self.power.tick(self.time_s)
        self._forget_pose()
        if self.program is not None and self.runtime_state == RuntimeState.PLAYING:
            self._run_program(self.program)
        try:
            self.arm.step(dt)
        except MotionError as error:
            log.warning("motion ended: %s", error)
            self.stop_program()
        self._forget_pose()
        if not self.arm.steady:
            self.moved_s = self.time_s
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
