"""How uncertain a solved calibration is: noise of points, and what all points of one sweep have in common.

An arm that is 0.3 mm off in one pose shifts a whole sweep. Such shifts show as residuals that agree within a sweep;
their size is estimated from there, so that a covariance does not shrink with the number of points of a sweep.
"""

from __future__ import annotations

import numpy as np

from perception.calibration.sightings import Sightings
from perception.calibration.targets import Distances
from perception.geometry import Array

LEAST_TOLD = 0.02
"""A direction in which a sweep's points say less than this share of what they say in the best one tells no shift: few
points on a port's walls would tell of these walls."""
SHIFT_ROUNDS = 6
LEAST_SCALE_M = 0.0001
"""Points that differ by less than three times this count together."""


def uncertainty(jacobian: Array, distances: Distances, weights: Array, seen: Sightings) -> Array:
    """Covariance (K, K) of all K columns of the Jacobian (N, K), in their own units."""
    noise = float(np.sum(weights * distances.residual**2) / max(1.0, np.sum(weights) - jacobian.shape[1]))
    squares, couplings = _sweeps(jacobian, distances, weights, seen, noise)
    normal = (jacobian * weights[:, None]).T @ jacobian
    pull = _point_pull(jacobian, weights * distances.residual)
    return sandwich(normal, pull, couplings, _shift_variance(squares, jacobian.shape[1]))


def sandwich(normal: Array, pull: Array, couplings: Array, shift: float) -> Array:
    """Covariance (K, K) for noisy points in sweeps that are each shifted with variance ``shift`` an axis.

    :param normal: (K, K) sum of outer products of the Jacobian's rows
    :param pull: (K, K) covariance of what the noise of the points pulls at the solution
    :param couplings: (S, K, 3) how a shift of each sweep pulls at the solution
    """
    scale = np.sqrt(np.diag(normal)) + 1e-300
    bread = np.linalg.inv(normal / np.outer(scale, scale) + 1e-14 * np.eye(len(normal)))
    pulls = couplings / scale[:, None]
    meat = pull / np.outer(scale, scale) + shift * np.einsum("ski,sli->kl", pulls, pulls)
    return np.asarray(bread @ meat @ bread / np.outer(scale, scale))


def _point_pull(jacobian: Array, weighted_residual: Array) -> Array:
    """(K, K) from each point's own residual (MacKinnon and White 1985, HC1): a laser's range noise is a smaller
    distance where it grazes a surface, and these points hold the target sideways."""
    points, parameters = jacobian.shape
    pulls = jacobian * weighted_residual[:, None]
    return np.asarray(pulls.T @ pulls * points / max(1, points - parameters))


def sweep_shifts(distances: Distances, seen: Sightings) -> Array:
    """(S, 3) by how much each sweep shows the target displaced in the base frame, as far as its points tell."""
    owner = seen.sweep_of_point
    return np.stack([_robust_shift(distances, owner == sweep) for sweep in np.unique(owner)])


def _robust_shift(distances: Distances, chosen: Array) -> Array:
    """(3,) of those of the chosen points that agree on one."""
    gradient, residual = distances.gradient[chosen], distances.residual[chosen]
    weights, shift = np.ones(len(distances.residual)), np.zeros(3)
    for _ in range(SHIFT_ROUNDS):
        shift, _ = _shift(distances, weights, chosen)
        left = residual - gradient @ shift
        scale_m = max(LEAST_SCALE_M, 1.4826 * float(np.median(np.abs(left))))
        weights[chosen] = np.clip(1.0 - (left / (3.0 * scale_m)) ** 2, 0.0, None) ** 2
    return shift


def _sweeps(
    jacobian: Array, distances: Distances, weights: Array, seen: Sightings, noise: float
) -> tuple[Array, Array]:
    """For each sweep its shift's mean square beyond noise (S,), and how a shift pulls at the solution (S, K, 3)."""
    owner, squares, couplings = seen.sweep_of_point, [], []
    for sweep in np.unique(owner):
        chosen = owner == sweep
        shift, spread = _shift(distances, weights, chosen)
        told = np.linalg.matrix_rank(spread, hermitian=True)
        squares.append(float(shift @ shift - noise * np.trace(spread)) / max(1, told))
        couplings.append(coupling(jacobian[chosen], weights[chosen], distances.gradient[chosen]))
    return np.array(squares), np.stack(couplings)


def coupling(jacobian: Array, weights: Array, gradient: Array) -> Array:
    """(K, 3) how a shift of one sweep's points pulls at the solution."""
    return np.asarray((jacobian * weights[:, None]).T @ gradient)


def _shift(distances: Distances, weights: Array, chosen: Array) -> tuple[Array, Array]:
    """Least-squares shift (3,) of the chosen points and its covariance for unit noise (3, 3)."""
    g, w = distances.gradient[chosen], weights[chosen]
    spread = np.linalg.pinv((g * w[:, None]).T @ g, rcond=LEAST_TOLD, hermitian=True)
    return np.asarray(spread @ (g * w[:, None]).T @ distances.residual[chosen]), np.asarray(spread)


def _shift_variance(squares: Array, parameters: int) -> float:
    """Variance of one component of a sweep's shift; the fit has taken some of it away already."""
    free = max(1.0, 3.0 * len(squares) - parameters)
    return max(0.0, float(squares.mean()) * 3.0 * len(squares) / free)
