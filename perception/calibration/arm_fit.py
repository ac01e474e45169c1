"""The last stage of a hand-eye calibration: the arm's own errors are estimated along with the mounting.

An arm that is off by tenths of a millimetre shows the target elsewhere from pose to pose. Without this stage the
mounting takes that up and is off itself. Sweeps of one target do not determine an arm's 19 errors; each is therefore
known beforehand to be of the size that arms have, and so is a shift of each sweep for what remains (maximum a
posteriori, Gaussian priors; the covariance is the posterior's).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from perception.calibration.arm_errors import COUNT
from perception.calibration.errors import CalibrationError
from perception.calibration.hand_eye import LEAST_SCALE_M, Asked, HandEye, biweight, mounting_jacobian, moved
from perception.calibration.sightings import Mounting, Sightings
from perception.calibration.targets import Target
from perception.geometry import Array

LENGTH_M, ZERO_RAD, GIVE_RAD_PER_NM = 0.00015, float(np.deg2rad(0.015)), 4e-6
"""1 sigma of what an arm does not know of itself: each length, each zero, and how far each joint gives."""
SHIFT_M = 2e-5
"""Least 1 sigma, each axis, of what else a sweep is displaced by: repeatability, times."""
ROUNDS, ROUNDS_OF_SHIFT = 4, 3
IMPLAUSIBLE = 4.0
"""Standard deviations: an arm that is so far off is another arm, or something moved."""
MOST_POINTS = 20_000


def prior_sigma() -> Array:
    """(19,) of the errors before the first sweep; all means are zero."""
    return np.array([LENGTH_M] * 12 + [ZERO_RAD] * 6 + [GIVE_RAD_PER_NM])


@dataclass(frozen=True, slots=True, eq=False)
class ArmFit:
    """Mounting and arm, as sweeps and what is known of arms have them together."""

    seen: Sightings
    """What the solution rests on, with the flange where it truly was."""
    hand_eye: HandEye
    errors: Array
    """(19,) in the order of ``arm_errors``."""
    covariance: Array
    """(25, 25) of the mounting's pose (as in ``HandEye``) and the errors."""
    shift_m: float
    """1 sigma, each axis, of what else each sweep is displaced by."""

    def located_sigma_m(self, jacobian: Array, place_in_flange: Array) -> float:
        """1 sigma, the three axes together, of the place of a port that is seen from one pose of the arm.

        :param jacobian: (6, 19) ``error_jacobian`` at that pose
        :param place_in_flange: (3,) of the port, metres
        """
        from_scanner = self.hand_eye.mounting.T_flange_scanner.inverse().apply(place_in_flange[None])[0]
        rotation = self.hand_eye.mounting.T_flange_scanner.rotation
        by_mounting = np.hstack([np.eye(3), -rotation @ _cross_matrix(from_scanner)])
        by_arm = np.hstack([np.eye(3), -_cross_matrix(place_in_flange)]) @ jacobian
        change = np.hstack([by_mounting, by_arm])
        return float(np.sqrt(np.trace(change @ self.covariance @ change.T)))


def fit_arm(seen: Sightings, solved: HandEye, jacobians: Sequence[Array], asked: Asked) -> ArmFit:
    """Start from a solution for a perfect arm.

    :param seen: what the solution rests on, with the arm's word for its poses
    :param jacobians: for each sweep (2, 6, 19), ``error_jacobian`` at its first and its last profile
    :raises CalibrationError: errors that no arm has
    """
    few = np.arange(len(seen)) % int(np.ceil(len(seen) / MOST_POINTS)) == 0
    stage = _Stage(seen.of(few), solved.mounting, solved.target.of(few), _along_sweeps(seen, jacobians), asked.columns)
    for _ in range(ROUNDS_OF_SHIFT):
        for _ in range(ROUNDS):
            stage.step()
        stage.judge_shifts()
    worst = float(np.abs(stage.errors / prior_sigma()).max())
    if worst > IMPLAUSIBLE:
        raise CalibrationError(
            f"the sweeps agree only for an arm whose zeros or lengths are off by {worst:.1f} times what arms are",
            remedy="Check that target, robot base and scanner are tight; --ideal-arm takes the arm at its word.",
        )
    return stage.result()


class _Stage:
    """Gauss-Newton on mounting, target, errors of the arm and shifts of the sweeps."""

    def __init__(
        self, told: Sightings, mounting: Mounting, target: Target, by_arm: Array, chosen: NDArray[np.bool_]
    ) -> None:
        self._told, self._by_arm, self._chosen = told, by_arm, chosen
        self._mounting, self._target, self.errors = mounting, target, np.zeros(COUNT)
        self._owner = np.unique(told.sweep_of_point, return_inverse=True)[1]
        self._shifts = np.zeros((int(self._owner.max()) + 1, 3))
        self._shift_m = SHIFT_M
        self._k, self._own = int(chosen.sum()), int(chosen.sum()) + target.parameters

    def step(self) -> None:
        """One step towards what is likeliest."""
        _, jacobian, residual, weights, noise = self._linear()
        pulled = np.concatenate([np.zeros(self._own), self.errors, self._shifts.ravel()]) * self._known()
        gradient = (jacobian * weights[:, None]).T @ residual / noise + pulled
        normal = self._normal(jacobian, weights, noise)
        scale = 1.0 / np.sqrt(np.diag(normal))
        step = -scale * np.linalg.solve(normal * np.outer(scale, scale), scale * gradient)
        self._mounting = moved(self._mounting, step[: self._k], self._chosen)
        self._target = self._target.moved(step[self._k : self._own])
        self.errors = self.errors + step[self._own : self._own + COUNT]
        self._shifts = self._shifts + step[self._own + COUNT :].reshape(-1, 3)

    def judge_shifts(self) -> None:
        """How large the sweeps' shifts are, uncertain as they are (expectation maximisation)."""
        uncertain = np.diag(self._covariance())[self._own + COUNT :]
        self._shift_m = max(SHIFT_M, float(np.sqrt(np.mean(self._shifts.ravel() ** 2 + uncertain))))

    def result(self) -> ArmFit:
        """What came out."""
        seen, _, residual, weights, _ = self._linear()
        found = self._covariance()
        both = np.r_[0:6, self._own : self._own + COUNT]
        mounting, estimated = np.zeros((8, 8)), np.flatnonzero(self._chosen)
        mounting[np.ix_(estimated, estimated)] = found[: self._k, : self._k]
        hand_eye = HandEye(self._mounting, self._target, mounting, residual, weights)
        return ArmFit(seen, hand_eye, self.errors, found[np.ix_(both, both)], self._shift_m)

    # --- inside

    def _linear(self) -> tuple[Sightings, Array, Array, Array, float]:
        """Sightings by the true arm, Jacobian (N, K), residuals (N,), weights (N,), variance of one residual."""
        seen = _by_true_arm(self._told, self._by_arm @ self.errors)
        distances = self._target.distances(seen.in_base(self._mounting) + self._shifts[self._owner])
        gradient, residual = distances.gradient, distances.residual
        weights = biweight(residual, LEAST_SCALE_M)
        shifts = np.zeros((len(residual), *self._shifts.shape))
        shifts[np.arange(len(residual)), self._owner] = gradient
        jacobian = np.column_stack(
            [
                mounting_jacobian(seen, self._mounting, distances)[:, self._chosen],
                distances.own,
                _arm_columns(seen, self._mounting, gradient, self._by_arm),
                shifts.reshape(len(residual), -1),
            ]
        )
        return seen, jacobian, residual, weights, float(np.sum(weights * residual**2) / np.sum(weights))

    def _known(self) -> Array:
        """(K,) one over the variances that are known beforehand, zero where nothing is."""
        shifts = np.full(self._shifts.size, self._shift_m**-2.0)
        return np.concatenate([np.zeros(self._own), prior_sigma() ** -2.0, shifts])

    def _normal(self, jacobian: Array, weights: Array, noise: float) -> Array:
        return np.asarray((jacobian * weights[:, None]).T @ jacobian / noise + np.diag(self._known()))

    def _covariance(self) -> Array:
        """(K, K) posterior."""
        _, jacobian, _, weights, noise = self._linear()
        normal = self._normal(jacobian, weights, noise)
        scale = 1.0 / np.sqrt(np.diag(normal))
        return np.asarray(np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale))


def _along_sweeps(seen: Sightings, jacobians: Sequence[Array]) -> Array:
    """(P, 6, 19) at each profile: straight between a sweep's ends, over which it changes little."""
    found = np.empty((len(seen.sweep), 6, COUNT))
    for sweep in np.unique(seen.sweep):
        own = seen.sweep == sweep
        way = np.linalg.norm(seen.translations[own] - seen.starts[own], axis=1)
        first, last = jacobians[sweep]
        found[own] = first + (way / way.max())[:, None, None] * (last - first)
    return found


def _by_true_arm(told: Sightings, twists: Array) -> Sightings:
    """With the flange where it truly was: ``twists`` (P, 6) in the told flange's frame."""
    turned = told.rotations @ Rotation.from_rotvec(twists[:, 3:]).as_matrix()
    way = np.einsum("pij,pj->pi", told.rotations, twists[:, :3])
    return replace(told, rotations=turned, translations=told.translations + way)


def _arm_columns(seen: Sightings, mounting: Mounting, gradient: Array, by_arm: Array) -> Array:
    """(N, 19) change of each distance with the arm's errors."""
    turned_back = np.einsum("nij,ni->nj", seen.rotations[seen.profile], gradient)
    levers = np.cross(seen.in_flange(mounting.T_flange_scanner), turned_back)
    twist = np.column_stack([turned_back, levers])
    return np.asarray(np.einsum("ni,nij->nj", twist, by_arm[seen.profile]))


def _cross_matrix(v: Array) -> Array:
    """(3, 3) with which ``v x w`` is a product."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
