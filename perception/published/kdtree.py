"""The adaptive KD-tree, equations (1) to (3): each node splits on its axis of largest standard deviation.

Takes points (N, 3) in any one unit; the method uses millimetres. A tree is built once for a scan. Denoising then only
changes which points count (``keep_only``), it never rebuilds. Every query is exact, so the split rule cannot change a
result, only the time: ``cycle`` (the paper's strawman) and ``extent`` are here for that comparison. The work is done by
an engine, ``kdtree_numpy`` or, when numba is installed, ``kdtree_numba``.
"""

from __future__ import annotations

import importlib
import importlib.util
from dataclasses import dataclass
from types import ModuleType
from typing import Literal

import numpy as np

from perception.errors import DegenerateCloudError, EmptyScanError
from perception.geometry import Array
from perception.published import kdtree_numpy
from perception.published.kdtree_numpy import LEAF, Indices, Mask, SplitRule, TreeArrays

EngineName = Literal["auto", "numpy", "numba"]


@dataclass(slots=True)
class TreeStats:
    """What a tree looks like and how much work it has done, in counted operations rather than time."""

    depth: int
    nodes: int
    leaves: int
    points_touched: int
    """Points looked at by all splits of the build: N x depth when all leaves are equally deep."""
    builds: int = 1
    mask_values_written: int = 0
    """Keep flags written by all updates of the mask; an update touches no node."""
    queries: int = 0
    nodes_visited: int = 0


def numba_available() -> bool:
    """Whether the compiled engine can be used."""
    return importlib.util.find_spec("numba") is not None


def _engine(name: EngineName) -> ModuleType:
    if name == "numpy" or (name == "auto" and not numba_available()):
        return kdtree_numpy
    return importlib.import_module("perception.published.kdtree_numba")


class AdaptiveKDTree:
    """A KD-tree on points (N, 3). Non-finite points are dropped and counted; indices refer to the caller's array."""

    def __init__(
        self, points: Array, leaf_size: int = 16, split: SplitRule = "std", *, engine: EngineName = "auto"
    ) -> None:
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise DegenerateCloudError(f"a cloud has the shape (N, 3), not {points.shape}")
        if leaf_size < 1:
            raise ValueError("a leaf holds at least one point")
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        if len(finite) == 0:
            raise EmptyScanError("the cloud holds no finite point")
        self.n, self.dropped = len(points), len(points) - len(finite)
        self._engine = _engine(engine)
        self._tree: TreeArrays = self._engine.build(points[finite], leaf_size, split)
        self._index: Indices = finite[self._tree.order]
        self._alive: Mask = np.ones(len(finite), dtype=bool)
        leaves = np.flatnonzero(self._tree.axis == LEAF)
        depth = int(np.log2(leaves.max() + 1))
        nodes = int((self._tree.axis >= LEAF).sum())
        self.stats = TreeStats(depth, nodes, len(leaves), self._tree.points_touched)

    @property
    def arrays(self) -> TreeArrays:
        """The nodes themselves, for tests and pictures."""
        return self._tree

    @property
    def kept(self) -> Indices:
        """Indices of the points that count, ascending."""
        return np.sort(self._index[self._alive])

    def keep_only(self, keep: Mask) -> None:
        """Let only points with ``keep`` (N,) set count in ``query_knn`` from now on: O(N), no node is touched."""
        self._alive = keep[self._index]
        self.stats.mask_values_written += len(self._index)

    def radius_stats(self, radius: float) -> tuple[Indices, Array]:
        """For each of the N points: neighbours within ``radius`` (not itself), and the sum of their distances.

        Of all points, whatever the mask. Dropped points get 0 and 0.
        """
        counts, sums, visited = self._engine.radius_statistics(self._tree, radius)
        self._count(len(self._index), visited)
        all_counts, all_sums = np.zeros(self.n, dtype=np.int64), np.zeros(self.n)
        all_counts[self._index], all_sums[self._index] = counts, sums
        return all_counts, all_sums

    def query_radius(self, queries: Array, radius: float) -> list[Indices]:
        """Indices of the points within ``radius`` of each query (Q, 3), ascending."""
        queries = np.atleast_2d(np.asarray(queries, dtype=np.float64))
        who, where, visited = self._engine.query_radius(self._tree, queries, np.full(len(queries), float(radius)))
        self._count(len(queries), visited)
        found = self._index[where]
        return [np.sort(part) for part in np.split(found, np.searchsorted(who, np.arange(1, len(queries))))]

    def query_knn(self, queries: Array, k: int) -> tuple[Array, Indices]:
        """Distances and indices (Q, k) of the k nearest kept points of each query (Q, 3), nearest first.

        :raises DegenerateCloudError: fewer than k points are kept.
        """
        queries = np.atleast_2d(np.asarray(queries, dtype=np.float64))
        if self._alive.sum() < k:
            raise DegenerateCloudError(f"{k} neighbours asked for, but only {self._alive.sum()} points are there")
        distances, where, visited = self._engine.query_knn(self._tree, queries, k, self._alive)
        self._count(len(queries), int(visited))
        return distances, self._index[where]

    def knn_of_kept(self, k: int) -> tuple[Indices, Array, Indices]:
        """The kept points' indices (n,), ascending; distances and indices (n, k) of their k nearest kept points.

        Queries run in tree order, neighbours after neighbours, which keeps the processor's cache warm.
        """
        kept = np.flatnonzero(self._alive)
        distances, neighbours = self.query_knn(self._tree.points[kept], k)
        ascending = np.argsort(self._index[kept])
        return self._index[kept][ascending], distances[ascending], neighbours[ascending]

    def _count(self, queries: int, visited: int) -> None:
        self.stats.queries += queries
        self.stats.nodes_visited += visited
