"""What the published method demands of a cloud before it starts, in millimetres.

It scales every length by the point spacing, so a wrong unit would pass unnoticed; a line or a plane leaves the pose
undetermined and any answer would be a guess. Both are refused here, with the reason.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from perception.errors import DegenerateCloudError, EmptyScanError, UnitError
from perception.geometry import Array
from perception.published.kdtree import AdaptiveKDTree

_SMALLEST_MM, _LARGEST_MM = 10.0, 10_000.0


def in_millimetres(points: Array, unit: Literal["mm", "m"] = "mm") -> Array:
    """Points (N, 3) in millimetres.

    :raises UnitError: the size is that of a port in another unit.
    :raises EmptyScanError: no finite point.
    """
    scaled = np.asarray(points, dtype=np.float64) * (1000.0 if unit == "m" else 1.0)
    finite = scaled[np.isfinite(scaled).all(axis=1)] if scaled.ndim == 2 else scaled[:0]
    if len(finite) == 0:
        raise EmptyScanError("the cloud holds no finite point")
    # stray returns far away say nothing about the unit
    low, high = np.percentile(finite, [1.0, 99.0], axis=0)
    extent = float((high - low).max())
    if 0.0 < extent < _SMALLEST_MM or extent > _LARGEST_MM:
        raise UnitError(f"the cloud is {extent:.3g} mm across; a port with its surroundings is 50 to 1,000 mm")
    return scaled


def check_shape(points: Array, smallest_count: int) -> None:
    """Refuse what cannot determine a pose: points (N, 3) finite, mm.

    :raises DegenerateCloudError: too few points, all identical, on a line or in a plane.
    """
    if len(points) < smallest_count:
        raise DegenerateCloudError(f"{len(points)} points are too few: {smallest_count} are needed")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    if spread[0] < 1e-6:
        raise DegenerateCloudError("all points are identical")
    if spread[1] < max(0.5, 0.005 * spread[0]):
        raise DegenerateCloudError("all points lie on a line, so a rotation about it is undetermined")
    if spread[2] < max(0.5, 0.005 * spread[0]):
        raise DegenerateCloudError("all points lie in a plane, so shifts within it are undetermined")


def spacing(tree: AdaptiveKDTree, points: Array) -> float:
    """Median distance to the nearest other point, from at most 2,000 of the points (N, 3).

    :raises DegenerateCloudError: more than half of the points are duplicates.
    """
    finite = points[np.isfinite(points).all(axis=1)]
    distances, _ = tree.query_knn(finite[:: max(1, len(finite) // 2000)], 2)
    s = float(np.median(distances[:, 1]))
    if s <= 0:
        raise DegenerateCloudError("more than half of the points are duplicates", remedy="Remove repeated points.")
    return s
