"""The search for the way in: a spiral across the port's face while the plug is turned to and fro. Pure.

Velocities follow the measured position, so that a plug that sticks is waited for and one that is late stays within
the radius.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controller.insertion_config import InsertionConfig
from perception.geometry import Array

FOLLOW_PER_S = 4.0
"""How fast a deviation from the spiral is made up."""
LOST_M = 0.0005
"""A plug that lags further behind sticks: the spiral waits for it."""
LOST_RAD = math.radians(0.3)


@dataclass(frozen=True, slots=True)
class Spiral:
    """An Archimedean spiral from the axis outwards, and a roll that swings."""

    radius_m: float
    pitch_m: float
    speed_m_s: float
    roll_rad: float
    roll_period_s: float
    turn_rad_s: float
    """Fastest roll."""

    @staticmethod
    def of(settings: InsertionConfig) -> Spiral:
        """As configured."""
        return Spiral(
            settings.search_radius_mm / 1000.0,
            settings.search_pitch_mm / 1000.0,
            settings.search_speed_mm_s / 1000.0,
            math.radians(settings.search_roll_deg),
            settings.search_roll_period_s,
            math.radians(settings.tilt_speed_limit_deg_s),
        )

    @property
    def length_m(self) -> float:
        """Of the whole spiral, to its outermost turn."""
        return math.pi * self.radius_m**2 / self.pitch_m

    def point(self, travelled_m: float) -> Array:
        """(2,) m after so much way: the radius grows with the root of the way, exact but for the first turn."""
        radius = min(self.radius_m, math.sqrt(travelled_m * self.pitch_m / math.pi))
        angle = 2.0 * math.pi * radius / self.pitch_m
        return radius * np.array([math.cos(angle), math.sin(angle)])

    def roll(self, time_s: float) -> float:
        """Rad about the axis after so much time."""
        return self.roll_rad * math.sin(2.0 * math.pi * time_s / self.roll_period_s)


@dataclass(frozen=True, slots=True)
class Step:
    """What to do until the next look, in the port's frame."""

    across_m_s: Array
    """(2,)"""
    turn_rad_s: float
    travelled_m: float
    """Way along the spiral at the end of the step."""


def next_step(spiral: Spiral, travelled_m: float, time_s: float, offset: Array, roll: float, step_s: float) -> Step:
    """The velocities that lead from where the plug is to where the spiral goes on."""
    behind = float(np.linalg.norm(spiral.point(travelled_m) - offset))
    turned_wrong = abs(spiral.roll(time_s) - roll)
    goes_on = behind < LOST_M and turned_wrong < LOST_RAD
    ahead_m = min(travelled_m + (spiral.speed_m_s * step_s if goes_on else 0.0), spiral.length_m)
    across = (
        FOLLOW_PER_S * (spiral.point(ahead_m) - offset) + (spiral.point(ahead_m) - spiral.point(travelled_m)) / step_s
    )
    size = float(np.linalg.norm(across))
    if size > spiral.speed_m_s:
        across = across * (spiral.speed_m_s / size)
    turn = FOLLOW_PER_S * (spiral.roll(time_s + step_s) - roll)
    turn += (spiral.roll(time_s + step_s) - spiral.roll(time_s)) / step_s
    return Step(across, float(np.clip(turn, -spiral.turn_rad_s, spiral.turn_rad_s)), ahead_m)
