"""The part of a port's mesh that a scanner in front of it can see, as evenly spread samples with normals.

Sampling is deterministic, so that a model's checksum stands for its samples too. Visibility comes from depth buffers
of the samples themselves, seen from directions over the front hemisphere; no ray-casting library is needed and holes,
degenerate triangles and inconsistent winding do no harm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Array

SPACING_M = 0.00035
FAR_M = 0.005
NEAR_EDGE_M = 0.0015
LEVEL_GAP_M = 0.001
EDGE_COSINE = 0.8
PIXEL_M = 0.0008
_RINGS = ((0.0, 1), (20.0, 6), (40.0, 8), (55.0, 8))
"""(angle from +z in degrees, number of directions around it)."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Samples of the visible surface, in the port frame."""

    points: Array
    """(M, 3) metres."""
    normals: Array
    """(M, 3) unit, towards the side it is seen from."""
    visibility: Array
    """(M,) share of the front directions that see the sample, above 0."""
    edge_m: Array
    """(M,) distance to the nearest sharp edge, at most ``FAR_M``; scan points near one mix two surfaces."""
    area_m2: Array
    """(M,) the area that each sample stands for."""
    level: Array
    """(M,) number of the flat, facing along the axis, that the sample is on; 0 on the rim plane and off flats."""

    def __len__(self) -> int:
        return len(self.points)

    def only(self, these: NDArray[np.bool_]) -> Surface:
        """Those that a mask (M,) keeps."""
        return Surface(*(getattr(self, name)[these] for name in self.__slots__))

    def thinned(self, spacing_m: float, edge_spacing_m: float) -> Surface:
        """Fewer samples, one for each cell and facing direction; denser near edges and where it may be curved."""
        facing = np.round(self.normals).astype(np.int64) @ np.array([1, 3, 9])
        fine = (self.edge_m < NEAR_EDGE_M) | (np.abs(self.normals).max(axis=1) < 0.9999)
        spacing = np.where(fine, edge_spacing_m, spacing_m)
        cells = np.floor(self.points / spacing[:, None]).astype(np.int64)
        key = np.column_stack([cells, facing, spacing > edge_spacing_m])
        _, keep, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
        area = np.asarray(np.bincount(group.reshape(-1), self.area_m2), dtype=np.float64)
        return Surface(
            self.points[keep], self.normals[keep], self.visibility[keep], self.edge_m[keep], area, self.level[keep]
        )


def sample_mesh(vertices: Array, faces: NDArray[np.int64], spacing_m: float) -> tuple[Array, Array]:
    """Points (N, 3) evenly spread over all triangles, one for each ``spacing_m`` squared, and their unit normals."""
    corners = vertices[faces]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(edge1, edge2)
    twice_area = np.linalg.norm(cross, axis=1)
    cumulative = np.cumsum(0.5 * twice_area) / spacing_m**2
    count = max(int(cumulative[-1]), 1)
    index = np.minimum(np.searchsorted(cumulative, np.arange(count) + 0.5), len(faces) - 1)
    # The R2 sequence (plastic number) fills a triangle more evenly than random numbers.
    k = np.arange(1, count + 1)
    u, v = (0.5 + 0.7548776662466927 * k) % 1.0, (0.5 + 0.5698402909980532 * k) % 1.0
    fold = u + v > 1.0
    u[fold], v[fold] = 1.0 - u[fold], 1.0 - v[fold]
    points = corners[index, 0] + u[:, None] * edge1[index] + v[:, None] * edge2[index]
    return points, cross[index] / np.maximum(twice_area[index], 1e-30)[:, None]


def visible_surface(vertices: Array, faces: NDArray[np.int64], spacing_m: float = SPACING_M) -> Surface:
    """Samples of the mesh that at least one direction of the front hemisphere sees.

    :param vertices: (V, 3) metres, port frame (+z out of the vehicle).
    :param faces: (F, 3) without degenerate triangles.
    """
    points, normals = sample_mesh(vertices, faces, spacing_m)
    directions = front_directions()
    front = np.zeros(len(points))
    back = np.zeros(len(points))
    for direction in directions:
        seen = _seen_from(points, normals, direction)
        facing = normals @ direction
        front += seen & (facing > 0.05)
        back += seen & (facing < -0.05)
    # Winding outwards as it should be: what is seen from behind is a leak. Otherwise take either side.
    if back.sum() > 0.05 * front.sum():
        flip = back > front
        normals = np.where(flip[:, None], -normals, normals)
        front = np.maximum(front, back)
    share = front / len(directions)
    keep = share >= 1.5 / len(directions)
    points, normals, share = points[keep], normals[keep], share[keep]
    area = np.full(len(points), spacing_m**2)
    return Surface(points, normals, share, _edge_distance(points, normals), area, _levels(points, normals))


def front_directions() -> Array:
    """(K, 3) unit vectors from the port towards possible viewpoints."""
    rows = []
    for angle_deg, count in _RINGS:
        azimuth = 2 * np.pi * np.arange(count) / count
        sine, cosine = np.sin(np.deg2rad(angle_deg)), np.cos(np.deg2rad(angle_deg))
        rows.append(np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.full(count, cosine)]))
    return np.concatenate(rows)


def _seen_from(points: Array, normals: Array, direction: Array) -> NDArray[np.bool_]:
    """Which samples are not hidden by others, seen along ``-direction`` without perspective."""
    across = np.linalg.svd(direction[None, :])[2][1:]
    pixel = np.floor(points @ across.T / PIXEL_M).astype(np.int64)
    pixel -= pixel.min(axis=0)
    width = int(pixel[:, 1].max()) + 1
    flat = pixel[:, 0] * width + pixel[:, 1]
    depth = points @ direction
    nearest = np.full(int(flat.max()) + 1, -np.inf)
    np.maximum.at(nearest, flat, depth)
    cosine = np.abs(normals @ direction)
    slope = np.sqrt(1.0 - np.minimum(cosine, 1.0) ** 2) / np.maximum(cosine, 0.2)
    return np.asarray(depth > nearest[flat] - (0.0003 + PIXEL_M * slope))


def _levels(points: Array, normals: Array) -> Array:
    """Numbers the heights at which surface faces along the axis; heights within ``LEVEL_GAP_M`` are one level."""
    facing = normals[:, 2] > 0.97
    bins = np.floor(points[:, 2] / (0.5 * LEVEL_GAP_M)).astype(np.int64)
    heights, counts = np.unique(bins[facing], return_counts=True)
    heights = heights[counts > 30]
    number = np.cumsum(np.diff(heights, prepend=heights[:1] - 9) > 1)
    level = np.zeros(len(points))
    for bin_, k in zip(heights, number, strict=True):
        level[facing & (bins == bin_)] = k
    level[np.abs(points[:, 2]) < LEVEL_GAP_M] = 0
    return level


def _edge_distance(points: Array, normals: Array, radius_m: float = 0.0007) -> Array:
    """How far each sample is from the nearest one whose neighbours within ``radius_m`` face another way."""
    index = np.asarray(cKDTree(points).query(points, k=9, distance_upper_bound=radius_m, workers=2)[1])
    index = np.where(index == len(points), np.arange(len(points))[:, None], index)
    cosine = np.einsum("nkj,nj->nk", normals[index], normals)
    at_edge = cosine.min(axis=1) < EDGE_COSINE
    if not at_edge.any():
        return np.full(len(points), FAR_M)
    distance: Array = cKDTree(points[at_edge]).query(points, workers=2)[0]
    return np.minimum(distance, FAR_M)
