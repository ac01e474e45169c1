"""The controller in ``evaluate calibration``: what it knows of a cell after sweeping a sphere, and makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from perception.calibration.arm_errors import COUNT, Weights, error_jacobian
from perception.calibration.arm_fit import ArmFit, fit_arm
from perception.calibration.find_sphere import find_sphere
from perception.calibration.hand_eye import Asked, HandEye, solve
from perception.calibration.sightings import Mounting, Sightings, sightings
from perception.evaluation.calibration_cells import RADIUS_M, START, Chain, TrueCell, draw_guess
from perception.geometry import Array, Pose, exp
from perception.scan import Scan

CENTRE = np.array([0.9, 0.1, 0.45])
SWEEPS = 10
ASKED = Asked(time_offset=True)
T_PORT_TCP = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.04]))
T_FLANGE_TCP = Pose(np.eye(3), np.array([0.0, 0.0, 0.2]))
"""What the controller believes."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What the controller knows after a calibration."""

    mounting: Mounting
    errors: Array
    """(19,) of the arm."""
    fit: ArmFit | None = None
    solved: HandEye | None = None
    """The solution with the arm taken at its word."""

    @property
    def ideal(self) -> Known:
        """A controller that takes the arm at its word."""
        assert self.solved is not None
        return Known(self.solved.mounting, np.zeros(COUNT))

    def flange(self, told: Pose) -> Pose:
        """Where the flange is taken to be when the arm tells this."""
        return told @ exp(error_jacobian_at(told) @ self.errors)

    def tcp(self, told: Pose) -> Pose:
        """The same of the TCP."""
        return self.flange(told @ T_FLANGE_TCP.inverse()) @ T_FLANGE_TCP

    def told(self, T_base_tcp: Pose) -> Pose:
        """What the arm is told to bring its TCP there."""
        flange = T_base_tcp @ T_FLANGE_TCP.inverse()
        return flange @ exp(error_jacobian_at(flange) @ self.errors).inverse() @ T_FLANGE_TCP

    def holds(self, T_flange_scanner: Pose) -> bool:
        """Whether this mounting lies in the stated 95 % ellipsoid, with the arm estimated too."""
        assert self.fit is not None
        return _inside_95(T_flange_scanner, self.fit.hand_eye)

    def holds_at_its_word(self, T_flange_scanner: Pose) -> bool:
        """The same of the solution that takes the arm at its word."""
        assert self.solved is not None
        return _inside_95(T_flange_scanner, self.solved)

    def located_sigma_m(self, T_base_port: Pose) -> float:
        """1 sigma of a port's place that is seen square on."""
        assert self.fit is not None
        seen_from = square_on(T_base_port, np.zeros(3), self.mounting.T_flange_scanner)
        place = seen_from.inverse().apply(T_base_port.translation[None])[0]
        return self.fit.located_sigma_m(error_jacobian_at(seen_from), place)


CHI2_6_95 = 12.592
"""95 % quantile of chi square with six degrees of freedom."""


def _inside_95(T_flange_scanner: Pose, found: HandEye) -> bool:
    off = pose_error(T_flange_scanner, found.mounting.T_flange_scanner)
    return float(off @ np.linalg.solve(found.covariance[:6, :6], off)) < CHI2_6_95


def pose_error(true: Pose, found: Pose) -> Array:
    """(6,) in the order and frames of the solver's covariance."""
    turn = Rotation.from_matrix(true.rotation.T @ found.rotation).as_rotvec()
    return np.concatenate([found.translation - true.translation, turn])


def calibrated_with_arm(cell: TrueCell, rng: np.random.Generator) -> Known:
    """Sweeps of a sphere, from a far guess; the arm's own errors are estimated along with the mounting."""
    sweeps = cell.sphere_sweeps(CENTRE, SWEEPS, rng)
    seen, solved = _solved(cell, sweeps, rng)
    ends = [np.stack([error_jacobian_at(scan.T_base_flange[k]) for k in (0, -1)]) for scan in sweeps]
    fit = fit_arm(seen, solved, ends, ASKED)
    return Known(fit.hand_eye.mounting, fit.errors, fit, solved)


def _solved(cell: TrueCell, sweeps: list[Scan], rng: np.random.Generator) -> tuple[Sightings, HandEye]:
    seen = sightings(sweeps, max_points=1500)
    found = find_sphere(seen, RADIUS_M, Mounting(draw_guess(cell.T_flange_scanner, rng)))
    seen = seen.of(found.on_sphere)
    return seen, solve(seen, found.target, found.mounting, ASKED)


def error_jacobian_at(T_base_flange: Pose) -> Array:
    """(6, 19) by the nominal kinematics."""
    arm = Chain.nominal()
    return np.asarray(error_jacobian(arm.frames(arm.joints_for(T_base_flange, START))[None], Weights())[0])


def square_on(T_base_port: Pose, view_rad: Array, T_flange_scanner: Pose) -> Pose:
    """T_base_flange from which the scanner looks squarely at a port, but for the view's tilt."""
    T_port_scanner = Pose.from_rotvec(view_rad) @ Pose(T_PORT_TCP.rotation, np.array([0.0, 0.0, 0.29]))
    return T_base_port @ T_port_scanner @ T_flange_scanner.inverse()
