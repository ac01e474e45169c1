"""Removal of discrete noise, equations (4) to (8): a point goes whose mean neighbour distance is out of the ordinary.

The statistics (4) to (7) do not depend on kappa. They are computed once for a scan; each round of the feedback then
only compares N numbers again (8). That is the one reading under which the paper's O(N) update is true.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.errors import DegenerateCloudError
from perception.geometry import Array
from perception.published.kdtree import AdaptiveKDTree
from perception.published.kdtree_numpy import Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class NoiseStatistics:
    """Equations (4) to (7) of one cloud."""

    eta: Array
    """(N,) mean distance to the neighbours within the radius (5), inf for a point that has none."""
    neighbours: Indices
    """(N,) how many neighbours there are, V_i."""
    mean: float
    """eta's mean over the points that have neighbours (6)."""
    sigma: float
    """eta's sample standard deviation over the same points (7): divided by I-1, where (2) divides by I, as printed."""


def noise_statistics(tree: AdaptiveKDTree, radius: float, min_neighbours: int = 1) -> NoiseStatistics:
    """Equations (4) to (7). A point with fewer than ``min_neighbours`` is isolated: (5) would divide by zero.

    :raises DegenerateCloudError: every point is isolated.
    """
    neighbours, distance_sums = tree.radius_stats(radius)  # (4)
    counted = neighbours >= max(1, min_neighbours)
    if not counted.any():
        raise DegenerateCloudError(
            f"no point has a neighbour within {radius:.3g}, so noise cannot be told from surface"
        )
    eta = np.full(tree.n, np.inf)
    eta[counted] = distance_sums[counted] / neighbours[counted]  # (5)
    mean = float(eta[counted].mean())  # (6)
    sigma = float(eta[counted].std(ddof=1)) if counted.sum() > 1 else 0.0  # (7)
    return NoiseStatistics(eta, neighbours, mean, sigma)


def keep_mask(statistics: NoiseStatistics, kappa: float, *, two_sided: bool = True) -> Mask:
    """Equation (8): which points stay, (N,). O(N); isolated points always go.

    As printed the interval is two-sided and so also removes densely scanned, good points; ``two_sided=False`` tests
    only for points that lie too far from their neighbours. With sigma = 0 the strict inequality would remove
    everything: then all points that have neighbours stay.
    """
    eta = statistics.eta
    if statistics.sigma <= 1e-12 * statistics.mean:
        return np.isfinite(eta)
    keep = eta < statistics.mean + kappa * statistics.sigma
    if two_sided:
        keep &= eta > statistics.mean - kappa * statistics.sigma
    return keep
