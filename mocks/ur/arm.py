"""The emulated arm: programmed motion, force mode, contact and force sensor, advanced in fixed steps.

One step is: motion target -> force mode -> contact -> wrench. The arm follows its program exactly (no dynamics;
contact does not bend it: the contact model's stiffness stands for arm, bracket and plug together).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mocks.spatial import moved_by, twist_between
from mocks.ur.kinematics import Kinematics
from mocks.ur.motion import Halt, Motion, MotionError, Reference
from mocks.ur.sag import Sag
from perception.geometry import Array

PAUSE_RAMP_S = 0.1
"""Emulated seconds in which a pause or a stop brings the path speed to zero."""
HISTORY_STEPS = 100
CONTACT_THRESHOLD_N = 8.0
TOOL_CONTACT_MEMORY = 50
ZERO_OVER_STEPS = 25


class Environment(Protocol):
    """What the tool can touch."""

    def step(self, T_base_flange: Array, dt: float) -> Array:
        """Wrench (6,) that the environment exerts on the tool at the plug's TCP, base axes."""


class FreeSpace:
    """Nothing to touch."""

    def step(self, T_base_flange: Array, dt: float) -> Array:
        return np.zeros(6)


class Floor:
    """A level surface of 20 N/mm at a height in the base frame; it touches the flange."""

    def __init__(self, height_m: float) -> None:
        self._height_m = height_m

    def step(self, T_base_flange: Array, dt: float) -> Array:
        return np.array([0.0, 0.0, 20e3 * max(0.0, self._height_m - float(T_base_flange[2, 3])), 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class ForceMode:
    """force_mode of URScript, type 2: the task frame stays where it is."""

    T_base_task: Array
    selection: tuple[bool, ...]
    wrench: Array
    limits: Array


class Sensor:
    """The force sensor in the flange: noise and a bias, removed by ``zero``."""

    def __init__(self, rng: np.random.Generator, noise_n: float, noise_nm: float, bias_n: float, bias_nm: float):
        self._rng = rng
        self._noise = np.repeat([noise_n, noise_nm], 3)
        self._offset = rng.uniform(-1.0, 1.0, 6) * np.repeat([bias_n, bias_nm], 3)
        self.filtered = np.zeros(6)
        self._recent: deque[Array] = deque(maxlen=ZERO_OVER_STEPS)

    def measure(self, wrench: Array) -> Array:
        """What the controller reports for a true wrench (6,)."""
        reading = wrench + self._offset + self._noise * self._rng.standard_normal(6)
        self.filtered += 0.5 * (reading - self.filtered)
        self._recent.append(reading)
        return np.asarray(reading)

    def zero(self) -> None:
        """Take the mean of the last readings as zero."""
        if self._recent:
            self._offset = self._offset - np.mean(self._recent, axis=0)
        self._recent.clear()
        self.filtered = np.zeros(6)


class Arm:
    """State of the arm and the one function that advances it."""

    def __init__(
        self,
        kinematics: Kinematics,
        q: Array,
        environment: Environment,
        sensor: Sensor,
        joint_offsets: Array | None = None,
        sag: Sag | None = None,
        built: Kinematics | None = None,
    ) -> None:
        """``joint_offsets`` (6,) rad: true joint angles minus those that the arm believes and reports. ``sag``: what
        gravity adds to them; None is a rigid arm. ``built``: the arm's true lengths; None: as it believes."""
        self._built = built or kinematics
        self._sag = sag
        self._joint_offsets = None if joint_offsets is None or not joint_offsets.any() else joint_offsets
        self.reference = Reference(kinematics, q)
        self.environment = environment
        self.sensor = sensor
        self.motion: Motion | None = None
        self.slider = 1.0
        self.paused = False
        self.ramp = 1.0
        self.force_mode: ForceMode | None = None
        self.force_gain = 1.0
        self.true_wrench = np.zeros(6)
        self.wrench = np.zeros(6)
        self.qdd = np.zeros(6)
        self.qd = np.zeros(6)
        self.history: deque[Array] = deque(maxlen=HISTORY_STEPS)
        self.contact_steps = 0
        self._path: Reference | None = None
        self._true_at: Array | None = None
        self._T_base_flange_true = np.eye(4)

    @property
    def q(self) -> Array:
        """Joints (6,) rad."""
        return self.reference.q

    @property
    def T_base_flange_true(self) -> Array:
        """Where the flange really is (4, 4): by true joint angles and lengths, which the arm itself does not know."""
        if self._joint_offsets is None and self._sag is None and self._built is self.reference.kinematics:
            return np.asarray(self.reference.links[5])
        if self._true_at is not self.q:  # joints are replaced, never changed: asked for several times in each step
            true = self.q if self._joint_offsets is None else self.q + self._joint_offsets
            if self._sag is not None:
                true = true + self._sag.deflection(true)
            self._true_at, self._T_base_flange_true = self.q, self._built.flange(true)
        return self._T_base_flange_true

    @property
    def scaling(self) -> float:
        """Speed slider times the ramp of a pause."""
        return self.slider * self.ramp

    def start(self, motion: Motion) -> Motion:
        """Replace the active motion."""
        self.motion = motion
        return motion

    def halt(self, deceleration: float = 4.0, linear: bool = False) -> Motion:
        """Replace the active motion by a deceleration, and leave force mode."""
        self.leave_force_mode()
        return self.start(Halt(deceleration, linear))

    def enter_force_mode(self, force_mode: ForceMode) -> None:
        """Start force mode or change its parameters."""
        if self.force_mode is None:
            self._path = Reference(self.reference.kinematics, self.q)
            self._path.T_flange_tcp = self.reference.T_flange_tcp
            self._path.refresh()
        self.force_mode = force_mode

    def leave_force_mode(self) -> None:
        """End force mode; a motion underneath goes on from where the arm is."""
        self.force_mode = self._path = None

    def set_tcp(self, T_flange_tcp: Array) -> None:
        """Change the TCP at rest."""
        self.reference.T_flange_tcp = T_flange_tcp
        self.reference.refresh()

    def step(self, dt: float) -> None:
        """Advance by ``dt`` of emulated time. Raises MotionError; the arm then rests where it was."""
        towards = 0.0 if self.paused else 1.0
        self.ramp += max(-dt / PAUSE_RAMP_S, min(dt / PAUSE_RAMP_S, towards - self.ramp))
        before = self.qd
        try:
            self._move(dt * self.scaling)
            self.qd = self.reference.qd * self.scaling
        except MotionError:
            self.stop_dead()
            raise
        finally:
            self.qdd = (self.qd - before) / dt
            self._sense(dt)

    def stop_dead(self) -> None:
        """Stand still at once (brakes)."""
        self.motion = None
        self.leave_force_mode()
        self.reference.rest()
        self.qd = np.zeros(6)

    @property
    def steady(self) -> bool:
        """At rest."""
        return float(np.abs(self.qd).max()) < 1e-4

    def tool_speed(self) -> Array:
        """TCP speed (6,) in base axes."""
        return np.asarray(self.reference.jacobian() @ self.qd)

    def contact_since(self, direction: Array) -> int:
        """Steps since something began to resist motion along ``direction`` (3,) (any, if null); 0 without contact."""
        force = self.sensor.filtered[:3]
        size = float(np.linalg.norm(direction))
        resisting = -float(force @ direction) / size if size > 1e-9 else float(np.linalg.norm(force))
        return max(1, self.contact_steps) if resisting > CONTACT_THRESHOLD_N else 0

    def _move(self, dt: float) -> None:
        if dt <= 1e-9:
            self.reference.rest()
        elif self.force_mode is not None and self._path is not None:
            self._comply(self.force_mode, self._path, dt)
        else:
            self._program(self.reference, dt)

    def _program(self, reference: Reference, dt: float) -> None:
        if self.motion is None:
            reference.rest()
            return
        self.motion.step(reference, dt)
        if self.motion.done:
            self.motion = None

    def _comply(self, mode: ForceMode, path: Reference, dt: float) -> None:
        """Compliant axes move in proportion to the force error, the others follow the program."""
        before = path.T_base_tcp
        self._program(path, dt)
        R = mode.T_base_task[:3, :3]
        programmed = twist_between(before, path.T_base_tcp)
        step = np.concatenate([R.T @ programmed[:3], R.T @ programmed[3:]])
        felt = np.concatenate([R.T @ self.sensor.filtered[:3], R.T @ self.sensor.filtered[3:]])
        gain = self.force_gain * FORCE_MODE_GAIN
        speed = np.clip(gain * (mode.wrench + felt), -mode.limits, mode.limits)
        step = np.where(mode.selection, speed * dt, step)
        twist = np.concatenate([R @ step[:3], R @ step[3:]])
        self.reference.follow(moved_by(self.reference.T_base_tcp, twist), dt)

    def _sense(self, dt: float) -> None:
        self.history.append(self.q)
        self.true_wrench = self.environment.step(self.T_base_flange_true, dt)
        self.wrench = self.sensor.measure(self.true_wrench)
        touching = float(np.linalg.norm(self.sensor.filtered[:3])) > 0.5 * CONTACT_THRESHOLD_N
        self.contact_steps = min(self.contact_steps + 1, TOOL_CONTACT_MEMORY) if touching else 0


FORCE_MODE_GAIN = np.repeat([0.002, 0.04], 3)
"""Speed per force error at gain scaling 1: m/s per N, rad/s per Nm."""
