"""Exact intervals of shares, quantiles, and how well a predicted covariance covers the errors that were made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, chi2

from perception.geometry import Array

LEVELS = (0.50, 0.68, 0.80, 0.90, 0.95, 0.99)
"""Nominal shares at which calibration is looked at."""


@dataclass(frozen=True, slots=True)
class Share:
    """``hits`` of ``n`` with the exact 95 % interval."""

    hits: int
    n: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share; NaN of nothing."""
        return self.hits / self.n if self.n else float("nan")

    def __str__(self) -> str:
        if not self.n:
            return "-"
        return f"{self.hits}/{self.n} = {self.value:.1%} [{self.low:.1%}, {self.high:.1%}]"


def share(hits: int, n: int, confidence: float = 0.95) -> Share:
    """The exact binomial interval (Clopper and Pearson, Biometrika 26, 1934)."""
    tail = (1.0 - confidence) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(1.0 - tail, hits + 1, n - hits))
    return Share(hits, n, low, high)


def quantile(values: Sequence[float], q: float) -> float:
    """The q-quantile; NaN of nothing."""
    return float(np.quantile(values, q)) if len(values) else float("nan")


@dataclass(frozen=True, slots=True)
class Calibration:
    """How often the truth lay within what the covariance predicts for each of ``LEVELS``."""

    ellipsoid: tuple[Share, ...]
    """Of the six-dimensional ellipsoid."""
    axes: tuple[tuple[Share, ...], ...]
    """Of each axis's own interval: x, y, z, then rotation about x, y, z; [axis][level]."""

    def ellipsoid_at(self, level: float) -> Share:
        """Coverage of the ellipsoid at one of ``LEVELS``."""
        return self.ellipsoid[LEVELS.index(level)]

    def axes_at(self, level: float) -> tuple[Share, ...]:
        """Coverage of the six axes at one of ``LEVELS``."""
        return tuple(axis[LEVELS.index(level)] for axis in self.axes)


def calibration(errors: Array, covariances: Array) -> Calibration:
    """From (N, 6) errors and their predicted (N, 6, 6) covariances."""
    n = len(errors)
    squared = np.array([mahalanobis2(e, c) for e, c in zip(errors, covariances, strict=True)])
    ratio = np.array([e / np.sqrt(np.diag(c)) for e, c in zip(errors, covariances, strict=True)]).reshape(n, 6)
    whole = tuple(share(int((squared <= chi2.ppf(level, 6)).sum()), n) for level in LEVELS)
    limit = [np.sqrt(chi2.ppf(level, 1)) for level in LEVELS]
    axes = tuple(tuple(share(int((np.abs(ratio[:, k]) <= x).sum()), n) for x in limit) for k in range(6))
    return Calibration(whole, axes)


def mahalanobis2(error: Array, covariance: Array) -> float:
    """Squared error in units of the covariance; infinite where the covariance is none."""
    try:
        value = float(error @ np.linalg.solve(covariance, error))
    except np.linalg.LinAlgError:
        return float("inf")
    return value if value >= 0 else float("inf")
