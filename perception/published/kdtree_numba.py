"""The same adaptive KD-tree, compiled by numba (the optional extra ``fast``).

Builds the very arrays of ``kdtree_numpy`` and answers the same four calls with the same results; ``kdtree`` takes this
engine by itself when numba can be imported. The first call on a machine compiles for some seconds, later ones read
numba's cache.
"""

from __future__ import annotations

import numpy as np

from perception.geometry import Array
from perception.published import kdtree_kernels as kernels
from perception.published.kdtree_numpy import ABSENT, LEAF, Indices, Mask, SplitRule, TreeArrays, depth_of

_RULES: dict[SplitRule, int] = {"std": 0, "cycle": 1, "extent": 2}


def build(points: Array, leaf_size: int, rule: SplitRule) -> TreeArrays:
    """Equations (1) to (3) with a median split by quickselect."""
    ordered, order = np.ascontiguousarray(points).copy(), np.arange(len(points))
    n_nodes = 2 ** (depth_of(len(points), leaf_size) + 1) - 1
    axis, split = np.full(n_nodes, ABSENT), np.zeros(n_nodes)
    start, end = np.zeros(n_nodes, dtype=np.int64), np.zeros(n_nodes, dtype=np.int64)
    lower, upper = np.full((n_nodes, 3), np.inf), np.full((n_nodes, 3), -np.inf)
    touched = kernels.fill_tree(ordered, order, axis, split, start, end, lower, upper, leaf_size, _RULES[rule])
    return TreeArrays(ordered, order, axis, split, start, end, lower, upper, int(touched))


def radius_statistics(tree: TreeArrays, radius: float) -> tuple[Indices, Array, int]:
    """As ``kdtree_numpy.radius_statistics``."""
    leaves = np.flatnonzero(tree.axis == LEAF)
    counts, sums = np.zeros(len(tree.points), dtype=np.int64), np.zeros(len(tree.points))
    args = (tree.points, tree.axis, tree.start, tree.end, tree.lower, tree.upper)
    visited = kernels.self_join(*args, leaves, float(radius), counts, sums)
    return counts, sums, int(visited)


def query_radius(tree: TreeArrays, queries: Array, radii: Array) -> tuple[Indices, Indices, int]:
    """As ``kdtree_numpy.query_radius``."""
    args = (tree.points, tree.axis, tree.start, tree.end, tree.lower, tree.upper, np.ascontiguousarray(queries), radii)
    counts = np.zeros(len(queries), dtype=np.int64)
    visited = kernels.radius(*args, counts, np.zeros(0, dtype=np.int64), False)
    first = np.cumsum(counts) - counts
    where = np.empty(int(counts.sum()), dtype=np.int64)
    kernels.radius(*args, first, where, True)
    return np.repeat(np.arange(len(queries)), counts), where, int(visited)


def query_knn(tree: TreeArrays, queries: Array, k: int, alive: Mask) -> tuple[Array, Indices, int]:
    """As ``kdtree_numpy.query_knn``."""
    squared, where = np.full((len(queries), k), np.inf), np.zeros((len(queries), k), dtype=np.int64)
    args = (tree.points, tree.axis, tree.start, tree.end, tree.lower, tree.upper, np.ascontiguousarray(queries))
    visited = kernels.knn(*args, alive, squared, where)
    return np.sqrt(squared), where, int(visited)
