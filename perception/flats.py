"""The port's flats: surfaces that face along its axis, level by level, with the distance to where each of them ends.

Seen straight on a port shows flats and hardly a wall. What then holds it sideways and in roll is where its flats end:
no point may lie on a flat beyond its edge, and no ray may have passed through it to a deeper one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from perception.geometry import Array

CELL_M = 0.00015
REACH_M = 0.003
"""Distances are cut off here."""
_FLAT = 0.97
"""A surface is flat whose normal has at least this cosine with the axis."""
_LEVEL_GAP_M = 0.0005
FLOOR_M = 0.025
"""Flats deeper than this below the rim are floors, each make's at its own depth; contacts end far above them."""
_SAME_M = 0.0003
_LEAST_AREA_M2 = 5e-6
"""Less than the tip of the smallest contact is no level."""


@dataclass(frozen=True, slots=True, eq=False)
class Flats:
    """L levels on one grid of ``CELL_M`` in the port's x-y plane."""

    low: Array
    """(2,) corner of the first cell."""
    heights: Array
    """(L,) z of each level, rising."""
    distance: NDArray[np.float32]
    """(L, X, Y) signed distance in millimetres to the level's edge: negative on the flat, NaN beside the port."""

    @property
    def shape(self) -> tuple[int, int]:
        """Cells along x and y."""
        return self.distance.shape[1], self.distance.shape[2]

    def level_at(self, z: Array) -> NDArray[np.int64]:
        """Number of the level nearest to heights (N,); -1 where none is within half the smallest gap."""
        if len(self.heights) == 0:
            return np.full(len(z), -1)
        nearest = np.abs(z[:, None] - self.heights).argmin(axis=1)
        return np.where(np.abs(z - self.heights[nearest]) < _LEVEL_GAP_M / 2, nearest, -1)

    def merged(self, gap_m: float) -> Flats:
        """The same with levels less than ``gap_m`` apart taken as one: a noisy scan cannot tell them apart."""
        if len(self.heights) == 0:
            return self
        group = np.cumsum(np.diff(self.heights, prepend=self.heights[0]) > gap_m)
        distance = np.stack([np.fmin.reduce(self.distance[group == k]) for k in range(group[-1] + 1)])
        heights = np.array([self.heights[group == k].mean() for k in range(group[-1] + 1)])
        return Flats(self.low, heights, distance)

    def lenient(self, where: NDArray[np.bool_], by_m: float) -> Flats:
        """The same, where distances to edges within a mask (X, Y) count only by what they exceed ``by_m``."""
        less = np.sign(self.distance) * np.maximum(np.abs(self.distance) - np.float32(1e3 * by_m), 0.0)
        return Flats(self.low, self.heights, np.where(where, less, self.distance).astype(np.float32))

    def without(self, heights_m: Sequence[float]) -> Flats:
        """The same, where the levels at these heights tell nothing: NaN all over."""
        silent = near_any(self.heights, heights_m)
        return Flats(self.low, self.heights, np.where(silent[:, None, None], np.float32(np.nan), self.distance))

    def beyond(self, level: NDArray[np.int64], xy: Array) -> Array:
        """Signed distance (N,) from the edges of the levels (N,) at places (N, 2).

        NaN beside the port, where the vehicle may be as high as any flat, and on levels that tell nothing.
        """
        return self.around(level, xy).beyond()

    def outward(self, level: NDArray[np.int64], xy: Array) -> Array:
        """Unit gradient (N, 2) of ``beyond``; 0 out of reach of an edge and beside the port."""
        return self.around(level, xy).outward(slice(None))

    def around(self, level: NDArray[np.int64], xy: Array) -> Around:
        """What ``beyond`` and ``outward`` rest on, for who wants both of the same places."""
        _, wide, high = self.distance.shape
        at = (xy - (self.low + 0.5 * CELL_M)) * (1.0 / CELL_M)
        cell = np.floor(at)
        i, j = cell.astype(np.int64).T
        inside = (i >= 0) & (i < wide - 1) & (j >= 0) & (j < high - 1)
        first = np.where(inside, (level * wide + i) * high + j, 0)
        values = self.distance.ravel()  # one number a cell: several times as fast to gather as three
        corners = np.stack([values.take(first + step) for step in (0, 1, high, high + 1)])
        return Around(corners, (at - cell).astype(np.float32), inside)


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """Places between the cells of their levels' maps."""

    corners: NDArray[np.float32]
    """(4, N) millimetres to the edge at the cells around: those of one x first."""
    between: NDArray[np.float32]
    """(N, 2) where between them, 0 to 1."""
    inside: NDArray[np.bool_]
    """(N,) whether the place is on the map."""

    def beyond(self) -> Array:
        """Signed distance (N,) in metres; NaN off the map."""
        c00, c01, c10, c11 = self.corners
        u, v = self.between.T
        near, far = c00 + v * (c01 - c00), c10 + v * (c11 - c10)
        return np.where(self.inside, near + u * (far - near), np.float32(np.nan)) * 1e-3

    def outward(self, which: NDArray[np.int64] | slice) -> Array:
        """Unit gradient (N, 2) at some of the places."""
        c00, c01, c10, c11 = self.corners[:, which]
        u, v = self.between[which].T
        slope = np.column_stack([(1 - v) * (c10 - c00) + v * (c11 - c01), (1 - u) * (c01 - c00) + u * (c11 - c10)])
        unit = slope / np.maximum(np.hypot(slope[:, 0], slope[:, 1]), 1e-9)[:, None]
        return np.asarray(np.nan_to_num(unit), dtype=np.float64)


def near_any(heights: NDArray[np.floating[Any]], of_m: Sequence[float]) -> NDArray[np.bool_]:
    """Which of the heights (N,) are one of the given ones."""
    away = np.abs(heights[:, None] - np.asarray(of_m, dtype=np.float64))
    return np.asarray(away.min(axis=1, initial=np.inf) < _SAME_M)


def build_flats(vertices: Array, faces: NDArray[np.int64]) -> Flats:
    """The flats of a mesh, vertices (V, 3) in metres and faces (F, 3), as seen from the front."""
    low = vertices[:, :2].min(axis=0) - REACH_M
    shape = np.ceil((vertices[:, :2].max(axis=0) + REACH_M - low) / CELL_M).astype(int)
    height, upright = _seen_from_front(vertices, faces, low, shape)
    known = np.isfinite(height)
    flat = known & (upright > _FLAT)
    heights = _levels(height[flat])
    distance = np.empty((len(heights), *shape), dtype=np.float32)
    for k, level in enumerate(heights):
        on = flat & (np.abs(height - level) < _LEVEL_GAP_M / 2)
        signed = (distance_transform_edt(~on) - distance_transform_edt(on)) * CELL_M
        signed -= np.sign(signed) * CELL_M / 2  # the edge lies between the cells on its two sides
        distance[k] = np.clip(signed, -REACH_M, REACH_M) * 1e3
        distance[k][~known] = np.nan
    return Flats(low, heights, as_kept(distance).astype(np.float32))


def as_kept(distance: NDArray[np.floating[Any]]) -> NDArray[np.float16]:
    """Distances as they are kept on disk: finer than the cells, in half the room."""
    return distance.astype(np.float16)


def _seen_from_front(
    vertices: Array, faces: NDArray[np.int64], low: Array, shape: NDArray[np.int64]
) -> tuple[Array, Array]:
    """(height, |z| of the normal), both (X, Y), of what a ray along -z meets first; NaN where nothing is."""
    import open3d as o3d  # takes a second to import, and only preparing a model needs it

    caster = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    caster.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))
    x, y = (low[k] + (np.arange(shape[k]) + 0.5) * CELL_M for k in range(2))
    top = float(vertices[:, 2].max()) + 0.01
    rays = np.zeros((*shape, 6), dtype=np.float32)
    rays[..., 0], rays[..., 1], rays[..., 2], rays[..., 5] = x[:, None], y, top, -1.0
    answer = caster.cast_rays(tensor(rays))
    reach = answer["t_hit"].numpy().astype(np.float64)
    height = np.where(np.isfinite(reach), top - reach, np.nan)
    return height, np.abs(answer["primitive_normals"].numpy()[..., 2])


def _levels(heights: Array) -> Array:
    """Heights (L,) at which there is enough surface; what lies within a gap of each other is one level."""
    values, counts = np.unique(np.round(heights / (_LEVEL_GAP_M / 5)), return_counts=True)
    values, counts = values[counts * CELL_M**2 > 1e-6], counts[counts * CELL_M**2 > 1e-6]
    if len(values) == 0:
        return np.zeros(0)
    group = np.cumsum(np.diff(values, prepend=values[0]) > 3)
    area = np.bincount(group, counts) * CELL_M**2
    middle = np.bincount(group, counts * values) / np.bincount(group, counts) * (_LEVEL_GAP_M / 5)
    return np.asarray(middle[area > _LEAST_AREA_M2])
