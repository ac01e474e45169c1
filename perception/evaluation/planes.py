"""Planes of a cloud by RANSAC, for baseline 1. Millimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.geometry import Array
from perception.published.kdtree_numpy import Indices


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """``normal . x = offset`` with its supporting points."""

    normal: Array
    offset: float
    members: Indices
    """Indices into the cloud."""


def find_planes(
    points: Array, rng: np.random.Generator, *, limit: int = 4, tolerance: float = 0.8, share: float = 0.05
) -> list[Plane]:
    """Up to ``limit`` planes within ``tolerance`` mm that hold at least ``share`` of the points, largest first."""
    left = np.arange(len(points))
    found: list[Plane] = []
    while len(found) < limit and len(left) >= max(3, share * len(points)):
        members = _largest_plane(points[left], rng, tolerance)
        if members.sum() < max(3, share * len(points)):
            break
        chosen = left[members]
        centre = points[chosen].mean(axis=0)
        normal = np.linalg.svd(points[chosen] - centre, full_matrices=False)[2][2]
        found.append(Plane(normal, float(normal @ centre), chosen))
        left = left[~members]
    return found


def _largest_plane(points: Array, rng: np.random.Generator, tolerance: float, samples: int = 150) -> np.ndarray:
    """Mask of the points on the plane through three random points that most others lie on."""
    sparse = points[:: max(1, len(points) // 1200)]
    a, b, c = (sparse[rng.integers(len(sparse), size=samples)] for _ in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.maximum(length, 1e-9)
    offsets = (normals * a).sum(axis=1)
    counts = (np.abs(sparse @ normals.T - offsets) < tolerance).sum(axis=0) * (length[:, 0] > 1.0)
    best = int(counts.argmax())
    return np.asarray(np.abs(points @ normals[best] - offsets[best]) < tolerance)
