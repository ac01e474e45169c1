"""Seven features of each point from the eigenvalues of its neighbourhood's covariance, equations (9) to (13).

The paper's (9) carries a sign that makes the matrix negative semidefinite and sums over the whole cloud; here it is the
covariance of each point's k nearest neighbours. (11) to (13) are printed with eigenvectors where only eigenvalues make
sense. All seven are functions of two numbers (beta2, beta3): P = 1-N = L+C, and S, Z and Q follow too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.geometry import Array
from perception.published.kdtree_numpy import Indices

FEATURE_NAMES = ("S", "L", "C", "N", "Z", "Q", "P")
"""Surface variation, linearity, planarity, sphericity, eigen-entropy, omnivariance, anisotropy."""
SURFACE_VARIATION = 0
_FLOOR = 1e-12


def covariances(points: Array, neighbours: Indices) -> Array:
    """Equation (9) with its sign put right: (n, 3, 3) from points (N, 3) and neighbour indices (n, k)."""
    local = points[neighbours]
    local -= local.mean(axis=1, keepdims=True)
    return np.asarray(np.swapaxes(local, 1, 2) @ local / neighbours.shape[1])


def shape_ratios(covariance: Array) -> Array:
    """beta1 >= beta2 >= beta3 (n, 3): eigenvalues, clamped above zero and then divided by their sum."""
    eigenvalues = np.linalg.eigvalsh(covariance)[:, ::-1]
    total = eigenvalues.sum(axis=1, keepdims=True)
    beta = np.maximum(eigenvalues / np.where(total > 0, total, 1.0), _FLOOR)
    return np.asarray(beta / beta.sum(axis=1, keepdims=True))


def eigen_features(points: Array, neighbours: Indices) -> Array:
    """(n, 7) in the order of ``FEATURE_NAMES``; ``neighbours`` (n, k) index ``points`` and hold the point itself."""
    beta = shape_ratios(covariances(points, neighbours))
    b1, b2, b3 = beta.T
    entropy = -(beta * np.log(beta)).sum(axis=1)  # (11)
    omnivariance = np.cbrt(b1 * b2 * b3)  # (12)
    return np.stack([b3, (b1 - b2) / b1, (b2 - b3) / b1, b3 / b1, entropy, omnivariance, (b1 - b3) / b1], axis=1)


def normals(points: Array, neighbours: Indices) -> Array:
    """(n, 3) unit normals of unknown sign: the eigenvectors that the features leave unused."""
    _, vectors = np.linalg.eigh(covariances(points, neighbours))
    return np.asarray(vectors[:, :, 0])


@dataclass(frozen=True, slots=True, eq=False)
class FeatureScale:
    """Mean and spread of the target's features: both clouds are standardised with these, never each with its own."""

    mean: Array
    spread: Array

    @staticmethod
    def of(features: Array) -> FeatureScale:
        """From the target's features (n, 7)."""
        return FeatureScale(features.mean(axis=0), np.maximum(features.std(axis=0), _FLOOR))

    def apply(self, features: Array) -> Array:
        """Standardised features (n, 7)."""
        return np.asarray((features - self.mean) / self.spread)
