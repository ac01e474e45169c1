"""What a scan lacks: parts of the port that were not seen, cut out of a complete cloud ("integrity")."""

from __future__ import annotations

import numpy as np

from perception.evaluation.sensor import Mask
from perception.evaluation.vehicle import Rng
from perception.geometry import Array


def integrity_cut(points: Array, share: float, rng: Rng) -> Mask:
    """Which of points (N, 3), port frame, remain when one side is cut off along a random in-plane direction."""
    turn = rng.uniform(0.0, 2 * np.pi)
    along = points[:, 0] * np.cos(turn) + points[:, 1] * np.sin(turn)
    keep: Mask = along <= np.quantile(along, share)
    return keep


def disc_cut(points: Array, share: float, rng: Rng, of: Mask | None = None) -> Mask:
    """Which of points (N, 3), port frame, lie outside a disc that hides all but ``share`` of those marked by ``of``."""
    turn, far = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.04, 0.16)
    centre = far * np.array([np.cos(turn), np.sin(turn)])
    distance = np.linalg.norm(points[:, :2] - centre, axis=1)
    counted = distance if of is None else distance[of]
    if len(counted) == 0:
        return np.ones(len(points), dtype=bool)
    keep: Mask = distance >= np.quantile(counted, 1.0 - share)
    return keep


def random_cuts(points: Array, of: Mask, share: float, rng: Rng) -> Mask:
    """Hide all but ``share`` of the points marked by ``of`` behind one or two discs or half planes."""
    cuts = int(rng.integers(1, 3))
    keep = np.ones(len(points), dtype=bool)
    for _ in range(cuts):
        keep &= disc_cut(points, share ** (1 / cuts), rng, of & keep)
    return keep
