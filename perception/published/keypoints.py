"""Keypoints, equations (14) to (16): centroids of average-linkage clusters.

The paper clusters "on the feature set" and then defines distances between coordinates. Read here: features *select* the
points on edges, coordinates *cluster* them. Clustering seven features without coordinates gives centroids that mean
nothing in space; that and plain clustering of all coordinates stay available for the comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from perception.errors import DegenerateCloudError
from perception.geometry import Array
from perception.published.features import SURFACE_VARIATION, FeatureScale
from perception.published.kdtree_numpy import Indices

KeypointMode = Literal["salient", "xyz", "joint", "feat"]


@dataclass(frozen=True, slots=True)
class KeypointSettings:
    """How keypoints are made. ``dist_min`` is in the cloud's unit (mm)."""

    mode: KeypointMode = "salient"
    salient_fraction: float = 0.25
    """Share of points with the largest surface variation that are clustered (mode ``salient``)."""
    dist_min: float = 2.5
    """Clusters closer than this are merged."""
    min_clusters: int = 10
    """A: merging stops at this many clusters. It is a floor, not a count."""
    min_size: int = 2
    """Smaller clusters give no keypoint."""
    max_points: int = 2500
    """Linkage needs n(n-1)/2 distances; more points are thinned on a voxel grid first."""


@dataclass(frozen=True, slots=True, eq=False)
class Keypoints:
    """Cluster centroids (16) with what they stand for."""

    points: Array
    """(m, 3)."""
    features: Array
    """(m, 7) mean features."""
    sizes: Indices
    """(m,) points in each cluster."""

    def __len__(self) -> int:
        return len(self.points)


def extract_keypoints(points: Array, features: Array, settings: KeypointSettings, scale: FeatureScale) -> Keypoints:
    """Keypoints of points (n, 3) with features (n, 7). ``scale`` is the target's.

    :raises DegenerateCloudError: no cluster is large enough.
    """
    chosen = np.arange(len(points))
    if settings.mode == "salient":
        chosen = select_salient(features, settings.salient_fraction)
    chosen = chosen[thin(points[chosen], settings.max_points)]
    space = _space(points[chosen], scale.apply(features[chosen]), settings)
    labels = average_linkage(space, settings.dist_min, settings.min_clusters)
    sizes = np.bincount(labels)
    large = sizes >= settings.min_size
    if not large.any():
        raise DegenerateCloudError("no cluster of points is large enough to be a keypoint")
    centroids = _means(points[chosen], labels)[large]  # (16)
    return Keypoints(centroids, _means(features[chosen], labels)[large], sizes[large])


def select_salient(features: Array, fraction: float) -> Indices:
    """Indices of the points whose surface variation is in the top ``fraction``, ascending."""
    s = features[:, SURFACE_VARIATION]
    return np.flatnonzero(s >= np.quantile(s, 1.0 - fraction))


def thin(points: Array, limit: int) -> Indices:
    """At most ``limit`` indices, ascending: the first point of each cell of a voxel grid that grows until they fit.

    Deterministic, but the grid is fixed to the axes: a rotated cloud keeps slightly different points.
    """
    if len(points) <= limit:
        return np.arange(len(points))
    lower = points.min(axis=0)
    edge = float((points.max(axis=0) - lower).max()) / limit
    while True:
        cells = np.floor((points - lower) / edge).astype(np.int64)
        _, first = np.unique(cells, axis=0, return_index=True)
        if len(first) <= limit:
            return np.sort(first)
        edge *= 1.1 if len(first) < 2 * limit else 1.5


def average_linkage(space: Array, dist_min: float, min_clusters: int) -> Indices:
    """Cluster label of each row of ``space`` (n, D), from 0: equations (14) and (15).

    Merging the closest pair while it is closer than ``dist_min`` and more than ``min_clusters`` clusters are left is a
    cut through the full dendrogram, because average linkage never merges at a smaller distance than before.
    """
    n = len(space)
    if n < 2:
        return np.zeros(n, dtype=np.int64)
    dendrogram = linkage(space, "average")
    at_threshold = n - int((dendrogram[:, 2] < dist_min).sum())
    return np.asarray(fcluster(dendrogram, max(min_clusters, at_threshold), "maxclust"), dtype=np.int64) - 1


def _space(points: Array, standardised: Array, settings: KeypointSettings) -> Array:
    """What is clustered: coordinates, features, or both with a feature's spread worth 10 mm."""
    if settings.mode == "feat":
        return standardised
    if settings.mode == "joint":
        return np.concatenate([points, 10.0 * standardised], axis=1)
    return points


def _means(values: Array, labels: Indices) -> Array:
    sizes = np.bincount(labels)
    sums = [np.bincount(labels, column) for column in values.T]
    return np.stack(sums, axis=1) / np.maximum(sizes, 1)[:, None]
