"""How uncertain a solved calibration is: noise of points, and what all points of one sweep have in common.

An arm that is 0.3 mm off in one pose shifts a whole sweep. Such shifts show as residuals that agree within a sweep;
their size is estimated from there, so that a covariance does not shrink with the number of points of a sweep.
"""

from __future__ import annotations

import numpy as np

from perception.calibration.sightings import Sightings
from perception.calibration.targets import Distances
from perception.geometry import Array


def uncertainty(jacobian: Array, distances: Distances, weights: Array, seen: Sightings) -> Array:
    """Covariance (K, K) of all K columns of the Jacobian (N, K), in their own units."""
    scale = np.sqrt(np.sum(weights[:, None] * jacobian**2, axis=0)) + 1e-300
    j = jacobian / scale
    weighted = j * weights[:, None]
    normal = weighted.T @ j
    bread = np.linalg.inv(normal + 1e-14 * np.eye(len(normal)))
    noise = float(np.sum(weights * distances.residual**2) / max(1.0, np.sum(weights) - j.shape[1]))
    shifts, couplings = _sweeps(weighted, distances, weights, seen, noise)
    shift = _shift_variance(shifts, j.shape[1])
    meat = noise * normal + shift * np.einsum("ski,sli->kl", couplings, couplings)
    return np.asarray(bread @ meat @ bread / np.outer(scale, scale))


def sweep_shifts(distances: Distances, weights: Array, seen: Sightings) -> Array:
    """(S, 3) by how much each sweep shows the target displaced in the base frame, as far as its points tell."""
    owner = seen.sweep_of_point
    return np.stack([_shift(distances, weights, owner == sweep)[0] for sweep in np.unique(owner)])


def _sweeps(
    weighted: Array, distances: Distances, weights: Array, seen: Sightings, noise: float
) -> tuple[Array, Array]:
    """For each sweep its shift's mean square beyond noise (S,), and how a shift pulls at the solution (S, K, 3)."""
    owner, squares, couplings = seen.sweep_of_point, [], []
    for sweep in np.unique(owner):
        chosen = owner == sweep
        shift, spread = _shift(distances, weights, chosen)
        squares.append(float(shift @ shift - noise * np.trace(spread)) / 3.0)
        couplings.append(weighted[chosen].T @ distances.gradient[chosen])
    return np.array(squares), np.stack(couplings)


def _shift(distances: Distances, weights: Array, chosen: Array) -> tuple[Array, Array]:
    """Least-squares shift (3,) of the chosen points and its covariance for unit noise (3, 3)."""
    g, w = distances.gradient[chosen], weights[chosen]
    spread = np.linalg.pinv((g * w[:, None]).T @ g, rcond=1e-4, hermitian=True)
    return np.asarray(spread @ (g * w[:, None]).T @ distances.residual[chosen]), np.asarray(spread)


def _shift_variance(squares: Array, parameters: int) -> float:
    """Variance of one component of a sweep's shift; the fit has taken some of it away already."""
    free = max(1.0, 3.0 * len(squares) - parameters)
    return max(0.0, float(squares.mean()) * 3.0 * len(squares) / free)
