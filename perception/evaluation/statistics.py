"""Medians, means and shares over trials with their 95 % bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from perception.geometry import Array

_RESAMPLES = 1000


@dataclass(frozen=True, slots=True)
class Estimate:
    """A statistic of ``n`` trials with the 2.5 and 97.5 % quantiles of its bootstrap distribution."""

    value: float
    low: float
    high: float
    n: int


def median(values: Sequence[float]) -> Estimate:
    """The median: what a typical trial gives."""
    return _bootstrap(np.asarray(values, dtype=np.float64), lambda a: np.median(a, axis=-1))


def mean(values: Sequence[float]) -> Estimate:
    """The mean: for losses it is governed by the few trials that failed."""
    return _bootstrap(np.asarray(values, dtype=np.float64), lambda a: a.mean(axis=-1))


def entry_errors(errors: Array) -> tuple[Estimate, Estimate, Estimate]:
    """MSE (19), RMSE (20) and MAE (21) over all entries (trials, entries); whole trials are drawn again."""
    squared = mean((errors**2).mean(axis=1).tolist())
    rooted = Estimate(squared.value**0.5, squared.low**0.5, squared.high**0.5, squared.n)
    return squared, rooted, mean(np.abs(errors).mean(axis=1).tolist())


def _bootstrap(values: Array, statistic: Callable[[Array], Array]) -> Estimate:
    if len(values) == 0:
        return Estimate(float("nan"), float("nan"), float("nan"), 0)
    rng = np.random.default_rng(len(values))  # fixed: a table made twice is the same table
    resampled = statistic(values[rng.integers(len(values), size=(_RESAMPLES, len(values)))])
    low, high = np.quantile(resampled, [0.025, 0.975])
    return Estimate(float(statistic(values)), float(low), float(high), len(values))
