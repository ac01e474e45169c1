"""The motions of the emulated controller: each advances the programmed joints by one step of emulated time.

Profiles are trapezoidal, as URScript documents them: the leading axis of a joint motion, the tool's path of a linear
one. Blends between way-points and circular paths are not simulated: the arm stops at each way-point.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from mocks.spatial import inverse_of, moved_by, twist_between
from mocks.ur.kinematics import JOINT_LIMIT_RAD, Kinematics
from perception.geometry import Array

MAX_JOINT_SPEED_RAD_S = math.pi


FOLLOWS_WITHIN = 1e-7
"""Metres and radians between the wanted and the reached pose of one step."""


class MotionError(Exception):
    """The motion cannot go on: out of reach, singular or beyond a joint limit."""


class Reference:
    """The programmed state that motions advance: joints, their speed, and the tool they carry."""

    def __init__(self, kinematics: Kinematics, q: Array) -> None:
        self.kinematics = kinematics
        self.q = q.copy()
        self.qd = np.zeros(6)
        self.T_flange_tcp = np.eye(4)
        self.refresh()

    def refresh(self, links: Array | None = None) -> None:
        """Recompute what follows from the joints."""
        self.links = self.kinematics.links(self.q) if links is None else links
        self.T_base_tcp = self.links[5] @ self.T_flange_tcp

    def jacobian(self) -> Array:
        """Jacobian (6, 6) of the TCP."""
        return self.kinematics.jacobian(self.links, self.T_base_tcp[:3, 3])

    def advance(self, q: Array, dt: float, links: Array | None = None) -> None:
        """Take new joints after ``dt``. Raises MotionError when they cannot be reached in that time."""
        qd = (q - self.q) / dt
        if not (np.abs(q).max() <= JOINT_LIMIT_RAD and np.abs(qd).max() <= 2.0 * MAX_JOINT_SPEED_RAD_S):
            raise MotionError("beyond a joint's limit, or no number")
        self.q, self.qd = q, qd
        self.refresh(links)

    def follow(self, T_base_tcp: Array, dt: float) -> None:
        """Take the joints that put the TCP at a pose close to the present one (Newton on the Jacobian)."""
        q, links = self.q, self.links
        for _ in range(8):
            tip = links[5] @ self.T_flange_tcp
            error = twist_between(tip, T_base_tcp)
            if np.abs(error).max() < FOLLOWS_WITHIN:
                self.advance(q, dt, links)
                return
            try:
                q = q + np.linalg.solve(self.kinematics.jacobian(links, tip[:3, 3]), error)
            except np.linalg.LinAlgError as singular:
                raise MotionError("singular") from singular
            links = self.kinematics.links(q)
        raise MotionError("out of reach or singular")

    def rest(self) -> None:
        """Stand still for one step."""
        self.qd = np.zeros(6)

    def tool_speed(self) -> Array:
        """TCP speed (6,) in base axes."""
        return np.asarray(self.jacobian() @ self.qd)


class Motion(Protocol):
    """A motion in progress."""

    done: bool

    def step(self, reference: Reference, dt: float) -> None:
        """Advance by ``dt`` of emulated time, already scaled by the speed slider."""


class Profile:
    """Trapezoid along a length: position after a time."""

    def __init__(self, length: float, speed: float, acceleration: float) -> None:
        self.length, self.acceleration = length, acceleration
        self.speed = min(speed, math.sqrt(length * acceleration)) if length > 0.0 else speed
        self.ramp_s = self.speed / acceleration
        self.cruise_s = max(0.0, length / self.speed - self.ramp_s) if length > 0.0 else 0.0
        self.duration_s = 2.0 * self.ramp_s + self.cruise_s if length > 0.0 else 0.0

    def at(self, time_s: float) -> float:
        """Share of the length, 0 to 1."""
        if time_s >= self.duration_s:
            return 1.0
        if time_s < self.ramp_s:
            travelled = 0.5 * self.acceleration * time_s**2
        elif time_s < self.ramp_s + self.cruise_s:
            travelled = self.speed * (time_s - 0.5 * self.ramp_s)
        else:
            travelled = self.length - 0.5 * self.acceleration * (self.duration_s - time_s) ** 2
        return travelled / self.length


class Halt:
    """Decelerate to rest: joint space (rad/s²) or, with ``linear``, by the tool's speed (m/s²)."""

    def __init__(self, deceleration: float, linear: bool = False) -> None:
        self.deceleration, self.linear = max(deceleration, 0.01), linear
        self.done = False

    def step(self, reference: Reference, dt: float) -> None:
        speed = float(np.abs(reference.qd).max())
        if self.linear and speed > 0.0:
            tool = reference.tool_speed()
            speed = max(float(np.linalg.norm(tool[:3])), float(np.linalg.norm(tool[3:])) * 0.25)
        factor = 1.0 - self.deceleration * dt / speed if speed > 1e-9 else 0.0
        if factor <= 0.0:
            reference.rest()
            self.done = True
            return
        qd = reference.qd * factor
        reference.advance(reference.q + qd * dt, dt)


class _FromRest:
    """A planned motion; an arm that still moves is brought to rest first."""

    def __init__(self, acceleration: float) -> None:
        self.done = False
        self._time_s = 0.0
        self._started = False
        self._halt = Halt(acceleration)

    def step(self, reference: Reference, dt: float) -> None:
        if not self._started:
            if np.abs(reference.qd).max() > 1e-6:
                self._halt.step(reference, dt)
                return
            self._started = True
            self._plan(reference)
        self._time_s += dt
        self._move(reference, dt)

    def _plan(self, reference: Reference) -> None:
        raise NotImplementedError

    def _move(self, reference: Reference, dt: float) -> None:
        raise NotImplementedError


class JointMove(_FromRest):
    """movej: all joints arrive together, the one with the longest way leads."""

    def __init__(self, q_target: Array, speed: float, acceleration: float) -> None:
        super().__init__(acceleration)
        self._target, self._speed, self._acceleration = q_target, speed, acceleration
        self._profile = Profile(0.0, speed, acceleration)
        self._start = q_target

    def _plan(self, reference: Reference) -> None:
        if np.abs(self._target).max() > JOINT_LIMIT_RAD:
            raise MotionError("joint limit")
        self._start = reference.q
        length = float(np.abs(self._target - self._start).max())
        self._profile = Profile(length, self._speed, self._acceleration)

    def _move(self, reference: Reference, dt: float) -> None:
        share = self._profile.at(self._time_s)
        reference.advance(self._start + share * (self._target - self._start), dt)
        self.done = share >= 1.0


class LinearMove(_FromRest):
    """movel: the TCP on a straight line, turning evenly."""

    def __init__(self, T_base_tcp: Array, speed: float, acceleration: float) -> None:
        super().__init__(acceleration)
        self._target, self._speed, self._acceleration = T_base_tcp, speed, acceleration
        self._profile = Profile(0.0, speed, acceleration)
        self._start = T_base_tcp
        self._twist = np.zeros(6)

    def _plan(self, reference: Reference) -> None:
        goal = self._target @ inverse_of(reference.T_flange_tcp)
        if reference.kinematics.inverse(goal, reference.q) is None:
            raise MotionError("out of reach")
        self._start = reference.T_base_tcp.copy()
        self._twist = twist_between(self._start, self._target)
        way, angle = float(np.linalg.norm(self._twist[:3])), float(np.linalg.norm(self._twist[3:]))
        self._profile = Profile(max(way, 0.25 * angle), self._speed, self._acceleration)

    def _move(self, reference: Reference, dt: float) -> None:
        share = self._profile.at(self._time_s)
        reference.follow(moved_by(self._start, share * self._twist), dt)
        self.done = share >= 1.0


class ToolVelocity:
    """speedl: the TCP's velocity (6,) in base axes is approached with an acceleration; goes on until replaced."""

    def __init__(self, velocity: Array, acceleration: float) -> None:
        self.velocity, self.acceleration = velocity, acceleration
        self.done = False

    def step(self, reference: Reference, dt: float) -> None:
        speed = approach(reference.tool_speed(), self.velocity, self.acceleration * dt)
        reference.follow(moved_by(reference.T_base_tcp, speed * dt), dt)


class JointVelocity:
    """speedj: joint velocities (6,), until replaced."""

    def __init__(self, velocity: Array, acceleration: float) -> None:
        self.velocity, self.acceleration = velocity, acceleration
        self.done = False

    def step(self, reference: Reference, dt: float) -> None:
        step = np.clip(self.velocity - reference.qd, -self.acceleration * dt, self.acceleration * dt)
        reference.advance(reference.q + (reference.qd + step) * dt, dt)


class Servo:
    """servoj: follow a joint target that the client keeps moving; lags by about the look-ahead time."""

    def __init__(self, q_target: Array, lookahead_s: float) -> None:
        self.q_target, self.lookahead_s = q_target, lookahead_s
        self.done = False

    def step(self, reference: Reference, dt: float) -> None:
        wanted = (self.q_target - reference.q) / max(self.lookahead_s, dt)
        wanted = np.clip(wanted, -MAX_JOINT_SPEED_RAD_S, MAX_JOINT_SPEED_RAD_S)
        step = np.clip(wanted - reference.qd, -40.0 * dt, 40.0 * dt)
        reference.advance(reference.q + (reference.qd + step) * dt, dt)


def approach(value: Array, target: Array, step: float) -> Array:
    """Velocity (6,) moved towards a target by at most ``step`` in translation (m/s) and in rotation (rad/s)."""
    moved = target.copy()
    for part in (slice(0, 3), slice(3, 6)):
        gap = target[part] - value[part]
        size = float(np.linalg.norm(gap))
        if size > step:
            moved[part] = value[part] + gap * (step / size)
    return moved
