"""Kinematics of the emulated arm: nominal DH parameters, forward, Jacobian, inverse.

Denavit-Hartenberg parameters as Universal Robots publishes them for each model. An arm as built differs by some tenths
of a millimetre (``as_built``), which it does not know of itself. The driver has kinematics of its own: the two are
compared in tests and share no code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from perception.geometry import Array


@dataclass(frozen=True, slots=True)
class Model:
    """One robot: DH lengths in metres, and what it can carry."""

    name: str
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float
    payload_kg: float
    reach_m: float


MODELS = {
    model.name: model
    for model in (
        Model("ur3e", 0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921, 3.0, 0.5),
        Model("ur5e", 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996, 5.0, 0.85),
        Model("ur7e", 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996, 7.5, 0.85),
        Model("ur10e", 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655, 12.5, 1.3),
        Model("ur12e", 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655, 12.5, 1.3),
        Model("ur15", 0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434, 17.5, 1.3),
        Model("ur16e", 0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655, 16.0, 0.9),
        Model("ur20", 0.2363, -0.8620, -0.7287, 0.2010, 0.1593, 0.1543, 20.0, 1.75),
        Model("ur30", 0.2363, -0.6370, -0.5037, 0.2010, 0.1593, 0.1543, 30.0, 1.3),
    )
}


def as_built(model: Model, length_errors_m: Array) -> Model:
    """The same robot with its lengths (d1, a2, a3, d4, d5, d6) off by so much, (6,) metres. Angles stay as drawn."""
    d1, a2, a3, d4, d5, d6 = (float(error) for error in length_errors_m)
    return replace(
        model,
        d1=model.d1 + d1,
        a2=model.a2 + a2,
        a3=model.a3 + a3,
        d4=model.d4 + d4,
        d5=model.d5 + d5,
        d6=model.d6 + d6,
    )


JOINT_LIMIT_RAD = 2.0 * math.pi
ROUNDING = 1e-7
"""A cosine may exceed 1 by this much: near a stretched elbow or wrist, rounding alone reaches its square root."""


class Kinematics:
    """Forward and inverse kinematics of one model; poses are (4, 4), joints (6,) rad."""

    def __init__(self, model: Model) -> None:
        self.model = model
        m = model
        alpha = np.array([math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0])
        self._ca, self._sa = np.round(np.cos(alpha)), np.round(np.sin(alpha))
        self._a = np.array([0.0, m.a2, m.a3, 0.0, 0.0, 0.0])
        self._d = np.array([m.d1, 0.0, 0.0, m.d4, m.d5, m.d6])

    def links(self, q: Array) -> Array:
        """Poses of the six link frames in the base frame, (6, 4, 4)."""
        A = self._single(q)
        for k in range(1, 6):
            A[k] = A[k - 1] @ A[k]
        return A

    def flange(self, q: Array) -> Array:
        """``T_base_flange``."""
        return np.asarray(self.links(q)[5])

    def jacobian(self, links: Array, point: Array) -> Array:
        """Geometric Jacobian (6, 6) of a point (3,) fixed to the flange, base axes: linear above angular."""
        axes = np.empty((3, 6))
        axes[:, 0] = (0.0, 0.0, 1.0)
        axes[:, 1:] = links[:5, :3, 2].T
        arms = np.empty((3, 6))
        arms[:, 0] = point
        arms[:, 1:] = (point - links[:5, :3, 3]).T
        J = np.empty((6, 6))
        J[0] = axes[1] * arms[2] - axes[2] * arms[1]
        J[1] = axes[2] * arms[0] - axes[0] * arms[2]
        J[2] = axes[0] * arms[1] - axes[1] * arms[0]
        J[3:] = axes
        return J

    def solutions(self, T_base_flange: Array, q6_if_free: float = 0.0) -> Array:
        """All joint vectors (K, 6) in (-pi, pi] that reach the pose; K is 0 when it is out of reach."""
        found: list[list[float]] = []
        for q1, q5, q6 in self._wrists(T_base_flange, q6_if_free):
            found += self._elbows(T_base_flange, q1, q5, q6)
        return np.array(found).reshape(-1, 6)

    def inverse(self, T_base_flange: Array, near: Array) -> Array | None:
        """The solution nearest to ``near`` (6,) within the joint limits, or None."""
        solutions = self.solutions(T_base_flange, float(near[5]))
        if len(solutions) == 0:
            return None
        turned = solutions + 2.0 * math.pi * np.round((near - solutions) / (2.0 * math.pi))
        turned = np.where(np.abs(turned) > JOINT_LIMIT_RAD + 1e-9, solutions, turned)
        return np.asarray(turned[np.argmin(np.abs(turned - near).sum(axis=1))])

    def _wrists(self, T: Array, q6_if_free: float) -> list[tuple[float, float, float]]:
        """Shoulder and wrist angles (q1, q5, q6): up to four."""
        m = self.model
        x, y = float(T[0, 3] - m.d6 * T[0, 2]), float(T[1, 3] - m.d6 * T[1, 2])
        radius = math.hypot(x, y)
        if radius < m.d4:
            return []
        wrists = []
        for shoulder in (1.0, -1.0):
            q1 = math.atan2(y, x) + math.pi / 2 + shoulder * math.acos(m.d4 / radius)
            c1, s1 = math.cos(q1), math.sin(q1)
            cosine = (T[0, 3] * s1 - T[1, 3] * c1 - m.d4) / m.d6
            if abs(cosine) > 1.0 + ROUNDING:
                continue
            angle = math.acos(max(-1.0, min(1.0, cosine)))
            for q5 in (angle, -angle):
                s5 = math.sin(q5)
                q6 = q6_if_free
                if abs(s5) > 1e-6:
                    q6 = math.atan2((-T[0, 1] * s1 + T[1, 1] * c1) / s5, (T[0, 0] * s1 - T[1, 0] * c1) / s5)
                wrists.append((q1, q5, q6))
        return wrists

    def _elbows(self, T: Array, q1: float, q5: float, q6: float) -> list[list[float]]:
        """Complete the planar part (q2, q3, q4): up to two."""
        m = self.model
        single = self._single(np.array([q1, 0.0, 0.0, 0.0, q5, q6]))
        T14 = np.linalg.solve(single[0], T) @ np.linalg.inv(single[4] @ single[5])
        x, y = float(T14[0, 3]), float(T14[1, 3])
        c3 = (x * x + y * y - m.a2**2 - m.a3**2) / (2.0 * m.a2 * m.a3)
        if abs(c3) > 1.0 + ROUNDING:
            return []
        elbows = []
        angle = math.acos(max(-1.0, min(1.0, c3)))
        for q3 in (angle, -angle):
            q2 = math.atan2(y, x) - math.atan2(m.a3 * math.sin(q3), m.a2 + m.a3 * math.cos(q3))
            q4 = math.atan2(T14[1, 0], T14[0, 0]) - q2 - q3
            elbows.append([math.remainder(angle, 2.0 * math.pi) for angle in (q1, q2, q3, q4, q5, q6)])
        return elbows

    def _single(self, q: Array) -> Array:
        """The six single-joint transforms (6, 4, 4), not chained."""
        c, s = np.cos(q), np.sin(q)
        A = np.zeros((6, 4, 4))
        A[:, 0, 0], A[:, 0, 1], A[:, 0, 2], A[:, 0, 3] = c, -s * self._ca, s * self._sa, self._a * c
        A[:, 1, 0], A[:, 1, 1], A[:, 1, 2], A[:, 1, 3] = s, c * self._ca, -c * self._sa, self._a * s
        A[:, 2, 1], A[:, 2, 2], A[:, 2, 3] = self._sa, self._ca, self._d
        A[:, 3, 3] = 1.0
        return A
