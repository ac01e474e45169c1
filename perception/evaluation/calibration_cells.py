"""Cells whose true geometry is hidden: an arm with joint and link errors, a scanner and a plug that sit elsewhere.

For ``evaluate calibration``. Rays meet a sphere by formula, arms are Denavit-Hartenberg chains: fast
enough for hundreds of calibrations. Not modelled: outliers, drop-outs, backlash, links that bend.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from perception.geometry import Array, Pose, exp
from perception.scan import Profile, Scan

RADIUS_M = 0.0254
JOINT_RAD = float(np.deg2rad(0.02))
LINK_M = 0.0002
"""Greatest errors of zeros and lengths that the arm does not know of: 0.6 mm at the port (median), as real arms are."""
GUESS_M, GUESS_RAD = 0.020, float(np.deg2rad(10.0))
"""Greatest error of the mounting that a calibration starts from."""
PROFILES, RAYS = 60, 120
SWEEP_M, SPEED_M_S = 0.12, 0.03
HALF_FAN = 0.17
COMPLIANCE_RAD_PER_NM, TIME_OFFSET_S = 3e-6, 0.005
"""Of joints under weight, each half as much to half as much again; and the greatest offset of the scanner's clock."""
G_M_S2 = 9.81
MASSES_KG = np.array([7.4, 13.1, 4.0, 2.1, 2.0, 0.6, 3.0])
"""Of a UR10e's links; plug and scanner."""
START = np.array([2.97, -1.2, 2.1, 2.2, -1.3, 0.0])
"""Joints from which poses are sought: elbow up before the port, so that scanning and docking are on one branch, as a
real arm is, which gets from one to the other in a straight line."""


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Denavit-Hartenberg rows (6, 4): a, alpha, d, theta offset; metres and radians. Lengths of a UR10e."""

    rows: Array

    @staticmethod
    def nominal() -> Chain:
        """As the maker publishes it."""
        q = np.pi / 2.0
        a = [0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0]
        alpha = [q, 0.0, 0.0, q, -q, 0.0]
        d = [0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655]
        return Chain(np.column_stack([a, alpha, d, np.zeros(6)]))

    def erring(self, joint_rad: float, link_m: float, rng: np.random.Generator) -> Chain:
        """The same with errors of joint zeros and link lengths, evenly up to these."""
        length, joint = ((-most, most, 6) for most in (link_m, joint_rad))
        errors = np.column_stack([rng.uniform(*length), np.zeros(6), rng.uniform(*length), rng.uniform(*joint)])
        return Chain(self.rows + errors)

    def flange(self, joints: Array) -> Pose:
        """T_base_flange at joints (6,)."""
        return Pose.from_matrix(self.frames(joints)[6])

    def torques(self, joints: Array) -> Array:
        """(6,) Nm that gravity puts on the joints (6,): links as masses in their middles, the load at the end."""
        frames = self.frames(joints)
        origins, axes = frames[:, :3, 3], frames[:6, :3, 2]
        masses = np.vstack([0.5 * (origins[:-1] + origins[1:]), origins[-1:]])
        arms = masses[None] - origins[:6, None]
        moments = np.einsum("ji,jki->jk", axes, np.cross(arms, [0.0, 0.0, -G_M_S2])) * MASSES_KG
        return np.asarray(np.triu(moments).sum(axis=1))  # a joint carries what comes after it

    def frames(self, joints: Array) -> Array:
        """(7, 4, 4): the base, then each link's frame in it."""
        matrix = np.eye(4)
        frames = [matrix]
        for (a, alpha, d, offset), angle in zip(self.rows, joints, strict=True):
            c, s, ca, sa = np.cos(angle + offset), np.sin(angle + offset), np.cos(alpha), np.sin(alpha)
            matrix = matrix @ np.array(
                [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]]
            )
            frames.append(matrix)
        return np.stack(frames)

    def joints_for(self, T_base_flange: Pose, near: Array) -> Array:
        """Joints (6,) that bring the flange there, from a start on the right branch. Raises ValueError out of reach."""

        def off(q: Array) -> Array:
            return np.asarray((T_base_flange.inverse() @ self.flange(q)).vector)

        solved = least_squares(off, near, xtol=1e-12, ftol=1e-14, gtol=1e-14)
        if np.abs(solved.fun).max() > 1e-7:
            raise ValueError("out of reach")
        return np.asarray(solved.x)


@dataclass(frozen=True, slots=True, eq=False)
class TrueCell:
    """What is true. The controller knows ``Chain.nominal()`` and guesses."""

    arm: Chain
    T_flange_scanner: Pose
    T_flange_tcp: Pose
    noise_m: float = 1e-4
    compliance_rad_per_nm: float | Array = 0.0
    """How far all joints, or each (6,), give under weight."""
    time_offset_s: float = 0.0
    """A profile is measured so much later than its time stamp says."""

    def true_flange(self, T_base_flange: Pose, near: Array = START) -> Pose:
        """Where the flange truly is when the arm says ``T_base_flange``."""
        joints = Chain.nominal().joints_for(T_base_flange, near)
        return self.arm.flange(joints + self.compliance_rad_per_nm * self.arm.torques(joints))

    def sphere_sweeps(self, centre: Array, count: int, rng: np.random.Generator) -> list[Scan]:
        """Sweeps over a sphere from ``count`` poses about it, with the arm's word for its poses."""
        return [self._sphere_sweep(centre, number, count, rng) for number in range(count)]

    def _sphere_sweep(self, centre: Array, number: int, count: int, rng: np.random.Generator) -> Scan:
        angle = 2.0 * np.pi * number / count
        tilt = np.deg2rad(26.0) * np.array([np.cos(angle), np.sin(angle)])
        roll = np.deg2rad(rng.uniform(-40.0, 40.0))
        aside = np.array([*rng.uniform(-0.015, 0.015, 2), -0.29 + rng.uniform(-0.035, 0.035)])
        turn = exp([0.0, 0.0, 0.0, tilt[0], tilt[1], 0.0]).rotation @ exp([0.0, 0.0, 0.0, 0.0, 0.0, roll]).rotation
        facing = FACING_X @ turn
        middle = Pose(facing, centre + facing @ aside)
        sign = 1.0 if number % 2 else -1.0
        ways = sign * np.linspace(-0.5, 0.5, PROFILES) * SWEEP_M
        believed = [middle.moved([0.0, way, 0.0]) @ self.T_flange_scanner.inverse() for way in ways]
        ends = [self.true_flange(believed[k]) for k in (0, -1)]
        error = [told.inverse() @ true for told, true in zip((believed[0], believed[-1]), ends, strict=True)]
        vectors = np.linspace(error[0].vector, error[1].vector, PROFILES)  # the arm's error changes little over a sweep
        profiles = []
        for k, pose in enumerate(believed):
            late = self.T_flange_scanner.moved([0.0, sign * SPEED_M_S * self.time_offset_s, 0.0])
            true = pose @ Pose.from_vector(vectors[k]) @ late
            time_s = k * SWEEP_M / SPEED_M_S / (PROFILES - 1)
            profiles.append(Profile(k, time_s, time_s, self._profile(true, centre, rng)))
        return Scan(tuple(profiles), tuple(believed), self.T_flange_scanner)

    def _profile(self, T_base_scanner: Pose, centre: Array, rng: np.random.Generator) -> Array:
        x = np.linspace(-HALF_FAN, HALF_FAN, RAYS)
        fan = np.column_stack([x, np.zeros(RAYS), np.ones(RAYS)]) / np.sqrt(1.0 + x**2)[:, None]
        rays, spoke = T_base_scanner.rotate(fan), centre - T_base_scanner.translation
        along = rays @ spoke
        root = along**2 - spoke @ spoke + RADIUS_M**2
        hit = root > 0.0
        ranges = along[hit] - np.sqrt(root[hit]) + rng.normal(0.0, self.noise_m, int(hit.sum()))
        return np.asarray((ranges[:, None] * fan[hit])[:, [0, 2]])


FACING_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A scanner that looks along the base's x axis, its own x along -y."""


def draw_cell(rng: np.random.Generator, joint_rad: float = 0.0, link_m: float = 0.0) -> TrueCell:
    """A cell whose scanner sits 0.1 m from the flange's axis, somehow tilted."""
    scanner = Pose.from_rotvec(rng.uniform(-0.1, 0.1, 3), np.array([0.0, -0.09, 0.04]) + rng.uniform(-0.02, 0.02, 3))
    tool = Pose.from_rotvec(rng.normal(0, np.deg2rad(0.1), 3), np.array([0, 0, 0.2]) + rng.normal(0, 0.0002, 3))
    return TrueCell(Chain.nominal().erring(joint_rad, link_m, rng), scanner, tool)


def with_all_errors(cell: TrueCell, rng: np.random.Generator) -> TrueCell:
    """The cell with an arm that hangs under its weight and a scanner whose clock is off, too."""
    give, late_s = COMPLIANCE_RAD_PER_NM * rng.uniform(0.5, 1.5, 6), rng.uniform(-TIME_OFFSET_S, TIME_OFFSET_S)
    return replace(cell, compliance_rad_per_nm=give, time_offset_s=late_s)


def draw_guess(true: Pose, rng: np.random.Generator) -> Pose:
    """A guess up to 20 mm and 10 deg off."""
    place, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    return true @ Pose.from_rotvec(rng.uniform(0, GUESS_RAD) * axis, rng.uniform(0, GUESS_M) * place)
