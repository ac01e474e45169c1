"""Hand-eye calibration: ``T_flange_scanner``, time offset and, when asked, speed scale from sweeps of one target.

Robust non-linear least squares on the profiles' own points: each residual is the distance of a measured point from the
target, so what a finished cloud would have blurred (time offset, sweep speed) is estimated along with the mounting.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from perception.calibration.errors import CalibrationError
from perception.calibration.observability import refuse_undetermined
from perception.calibration.sightings import Mounting, Sightings
from perception.calibration.targets import Distances, Target
from perception.calibration.uncertainty import uncertainty
from perception.geometry import Array, Pose, exp

START_SCALE_M = 0.004
"""The coarse stage leaves no larger distance than about this."""
LEAST_SCALE_M = 0.0003
ROUNDS_A_SCALE = 8
SMALL_STEP = 1e-9

T = TypeVar("T", bound=Target)


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """A solved hand-eye calibration."""

    mounting: Mounting
    target: Target
    covariance: Array
    """(8, 8) of x, y, z (m, flange frame), rotation vector (rad, scanner frame), time offset (s), speed scale. Rows of
    what was not estimated are zero."""
    residuals_m: Array
    """(N,) of all points."""
    weights: Array
    """(N,) 0 to 1: what counted."""

    @property
    def rms_m(self) -> float:
        """Of the points that counted."""
        return float(np.sqrt(np.sum(self.weights * self.residuals_m**2) / np.sum(self.weights)))


@dataclass(frozen=True, slots=True)
class Asked:
    """What is estimated beside the pose."""

    time_offset: bool = True
    speed_scale: bool = False

    @property
    def columns(self) -> NDArray[np.bool_]:
        """(8,) which of the parameters are estimated."""
        return np.array([True] * 6 + [self.time_offset, self.speed_scale])


def solve(
    seen: Sightings, target: Target, guess: Mounting, asked: Asked | None = None, start_scale_m: float = START_SCALE_M
) -> HandEye:
    """The mounting with which all sweeps show one and the same target.

    :param seen: points that lie on the target, strays excepted
    :param target: roughly where the coarse stage found it
    :param start_scale_m: distances up to about three times this count at first
    :raises CalibrationError: fewer points than parameters, or steps that do not settle
    """
    chosen = (asked or Asked()).columns
    if len(seen) < 50:
        raise CalibrationError(f"{len(seen)} points lie on the target: too few")
    mounting, target, scale_m = fitted(seen, target, guess, chosen, start_scale_m)
    distances = target.distances(seen.in_base(mounting))
    weights = biweight(distances.residual, scale_m)
    jacobian = np.column_stack([mounting_jacobian(seen, mounting, distances)[:, chosen], distances.own])
    refuse_undetermined(jacobian, weights, chosen)
    estimated = np.flatnonzero(chosen)
    covariance = np.zeros((8, 8))
    covariance[np.ix_(estimated, estimated)] = uncertainty(jacobian, distances, weights, seen)[
        : len(estimated), : len(estimated)
    ]
    return HandEye(mounting, target, covariance, distances.residual, weights)


def fitted(
    seen: Sightings, target: T, guess: Mounting, chosen: NDArray[np.bool_], start_scale_m: float
) -> tuple[Mounting, T, float]:
    """Mounting and target that fit best, and the scale (m) that distances were judged by in the end.

    :param chosen: (8,) which of the mounting's parameters may change; whether the sweeps determine them is not asked
    """
    mounting, scale_m = guess, start_scale_m
    while True:
        for _ in range(ROUNDS_A_SCALE):
            distances = target.distances(seen.in_base(mounting))
            jacobian = np.column_stack([mounting_jacobian(seen, mounting, distances)[:, chosen], distances.own])
            weights = biweight(distances.residual, scale_m)
            step = _step(jacobian, distances.residual, weights)
            mounting = moved(mounting, step[: chosen.sum()], chosen)
            target = target.moved(step[chosen.sum() :])
            if np.abs(step).max() < SMALL_STEP:
                break
        if scale_m <= LEAST_SCALE_M:
            return mounting, target, scale_m
        scale_m = max(LEAST_SCALE_M, min(0.6 * scale_m, 5.0 * _spread(distances.residual)))


def mounting_jacobian(seen: Sightings, mounting: Mounting, distances: Distances) -> Array:
    """(N, 8): change of each distance with the parameters in the order of ``HandEye.covariance``."""
    turned_back = np.einsum("nij,ni->nj", seen.rotations[seen.profile], distances.gradient)
    in_scanner = turned_back @ mounting.T_flange_scanner.rotation
    points = np.column_stack([seen.xz[:, 0], np.zeros(len(seen)), seen.xz[:, 1]])
    arm = seen.in_base(mounting) - seen.translations[seen.profile]
    flow = mounting.speed_scale * seen.velocities[seen.profile] + np.cross(seen.spins[seen.profile], arm)
    way = (seen.translations - seen.starts + mounting.time_offset_s * seen.velocities)[seen.profile]
    return np.column_stack(
        [
            turned_back,
            np.cross(points, in_scanner),
            np.einsum("ni,ni->n", distances.gradient, flow),
            np.einsum("ni,ni->n", distances.gradient, way),
        ]
    )


def moved(mounting: Mounting, step: Array, chosen: NDArray[np.bool_]) -> Mounting:
    """With its chosen parameters (8,) changed by ``step``."""
    full = np.zeros(8)
    full[chosen] = step
    turned = mounting.T_flange_scanner @ exp([0.0, 0.0, 0.0, *full[3:6]])
    moved = Pose(turned.rotation, turned.translation + full[:3])
    return Mounting(moved, mounting.time_offset_s + float(full[6]), mounting.speed_scale + float(full[7]))


def biweight(residual: Array, scale_m: float) -> Array:
    """Tukey's biweight (N,)."""
    return np.clip(1.0 - (residual / (3.0 * scale_m)) ** 2, 0.0, None) ** 2


def _spread(residual: Array) -> float:
    """Robust standard deviation."""
    return float(1.4826 * np.median(np.abs(residual)))


def _step(jacobian: Array, residual: Array, weights: Array) -> Array:
    """A damped Gauss-Newton step; columns are scaled, so that metres, radians and seconds weigh alike."""
    scale = np.sqrt(np.sum(weights[:, None] * jacobian**2, axis=0)) + 1e-12
    j = jacobian / scale
    normal = (j * weights[:, None]).T @ j + 1e-9 * np.eye(j.shape[1])
    return np.asarray(-np.linalg.solve(normal, (j * weights[:, None]).T @ residual) / scale)
