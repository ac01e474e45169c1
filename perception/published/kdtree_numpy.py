"""The reference engine of the adaptive KD-tree, in numpy alone: build by levels, queries by frontiers of nodes.

Nothing here loops over points. A level of the tree has nodes of at most two sizes (both halves of a median split differ
by one point at most), so each size is one matrix (nodes, size, 3) and equations (1) to (3) are one line each. Nodes are
numbered as in a heap: the children of i are 2i+1 and 2i+2. ``kdtree_numba`` offers the same four functions, compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
SplitRule = Literal["std", "cycle", "extent"]

LEAF = -1
ABSENT = -2
_CHUNK = 2_000_000
"""Largest number of distances held at once."""


@dataclass(frozen=True, slots=True, eq=False)
class TreeArrays:
    """A built tree. Positions run in tree order; ``order`` leads back to the caller's points."""

    points: Array
    """(N, 3) in tree order."""
    order: Indices
    """(N,) index of each tree position in the caller's array."""
    axis: Indices
    """(M,) split axis of each node, ``LEAF`` or ``ABSENT``."""
    split: Array
    """(M,) split value: the coordinate of the first point of the right half."""
    start: Indices
    end: Indices
    """(M,) each node's range of tree positions."""
    lower: Array
    upper: Array
    """(M, 3) closed bounding box of each node's points; points equal to a split value may lie in both children."""
    points_touched: int
    """Sum over all split nodes of their number of points: the counted cost of the build."""


def build(points: Array, leaf_size: int, rule: SplitRule) -> TreeArrays:
    """Equations (1) to (3) with a median split by selection, level by level."""
    n = len(points)
    levels = depth_of(n, leaf_size)
    size_of_heap = 2 ** (levels + 1) - 1
    order = np.arange(n)
    axis = np.full(size_of_heap, ABSENT)
    split = np.zeros(size_of_heap)
    start, end = np.zeros(size_of_heap, dtype=np.int64), np.zeros(size_of_heap, dtype=np.int64)
    axis[0], end[0] = LEAF, n
    nodes, touched = np.zeros(1, dtype=np.int64), 0
    for level in range(levels):
        sizes = end[nodes] - start[nodes]
        grown = []
        for size in np.unique(sizes[sizes > leaf_size]):
            group = nodes[sizes == size]
            rows = start[group, None] + np.arange(size)
            chosen, divisible = _split_axis(points[order[rows]], rule, level)
            group, rows, chosen = group[divisible], rows[divisible], chosen[divisible]
            half = size // 2
            keys = points[order[rows], chosen[:, None]]
            ranked = np.argpartition(keys, half, axis=1)
            order[rows] = np.take_along_axis(order[rows], ranked, axis=1)
            touched += rows.size
            axis[group], split[group] = chosen, points[order[rows[:, half]], chosen]
            left, right = 2 * group + 1, 2 * group + 2
            axis[left] = axis[right] = LEAF
            start[left], end[left] = start[group], start[group] + half
            start[right], end[right] = start[group] + half, end[group]
            grown += [left, right]
        nodes = np.concatenate(grown) if grown else nodes[:0]
    ordered = points[order]
    lower, upper = _boxes(ordered, axis, start, end)
    return TreeArrays(ordered, order, axis, split, start, end, lower, upper, touched)


def depth_of(n: int, leaf_size: int) -> int:
    """ceil(log2(N / leaf)), without rounding trouble: a median split halves whatever axis it takes."""
    depth = 0
    while n > leaf_size:
        n, depth = (n + 1) // 2, depth + 1
    return depth


def _split_axis(c: Array, rule: SplitRule, level: int) -> tuple[Indices, Mask]:
    """The axis for each node of ``c`` (nodes, points, 3), and whether the node can be divided at all."""
    extent = c.max(axis=1) - c.min(axis=1)
    divisible = extent.max(axis=1) > 0
    if rule == "cycle":
        return np.full(len(c), level % 3), divisible
    if rule == "extent":
        return extent.argmax(axis=1), divisible
    mu = c.mean(axis=1, keepdims=True)  # (1)
    variance = ((c - mu) ** 2).mean(axis=1)  # (2), squared: the order is the same
    return variance.argmax(axis=1), divisible  # (3), ties to the lowest axis


def _boxes(points: Array, axis: Indices, start: Indices, end: Indices) -> tuple[Array, Array]:
    """Bounding boxes: of the leaves from their points, of the others from their children."""
    lower, upper = np.full((len(axis), 3), np.inf), np.full((len(axis), 3), -np.inf)
    leaves = np.flatnonzero(axis == LEAF)
    leaves = leaves[np.argsort(start[leaves])]
    lower[leaves] = np.minimum.reduceat(points, start[leaves])
    upper[leaves] = np.maximum.reduceat(points, start[leaves])
    first = len(axis) // 2
    while first > 0:  # one level of the heap at a time, from the last but one to the root
        nodes = np.arange(first // 2, first)
        nodes = nodes[axis[nodes] >= 0]
        lower[nodes] = np.minimum(lower[2 * nodes + 1], lower[2 * nodes + 2])
        upper[nodes] = np.maximum(upper[2 * nodes + 1], upper[2 * nodes + 2])
        first //= 2
    return lower, upper


def radius_statistics(tree: TreeArrays, radius: float) -> tuple[Indices, Array, int]:
    """Neighbours within ``radius`` of each point and their distances' sum, (N,) each in tree order; nodes visited.

    Joins the tree with itself: pairs of nodes with boxes too far apart go, pairs of leaves become blocks of distances.
    """
    counts, sums = np.zeros(len(tree.points)), np.zeros(len(tree.points))
    a, b, visited = _leaf_pairs(tree, radius)
    size_a, size_b = tree.end[a] - tree.start[a], tree.end[b] - tree.start[b]
    shapes = np.unique(np.stack([size_a, size_b], axis=1), axis=0)
    for rows, columns in shapes:
        members = np.flatnonzero((size_a == rows) & (size_b == columns))
        for chunk in np.array_split(members, 1 + members.size * rows * columns // _CHUNK):
            for first in range(0, rows, 1024):  # only the oversize leaf of identical points is longer
                _add_block(tree, radius, a[chunk], b[chunk], np.arange(first, min(first + 1024, rows)), counts, sums)
    return counts.astype(np.int64), sums, visited


def _leaf_pairs(tree: TreeArrays, radius: float) -> tuple[Indices, Indices, int]:
    """All unordered pairs of leaves (a leaf with itself included) whose boxes are within ``radius``."""
    a, b, visited = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64), 0
    while True:
        gap = np.maximum(0, np.maximum(tree.lower[a] - tree.upper[b], tree.lower[b] - tree.upper[a]))
        near = (gap**2).sum(axis=1) <= radius**2
        visited += len(a)
        a, b = a[near], b[near]
        if (tree.axis[a] == LEAF).all() and (tree.axis[b] == LEAF).all():
            return a, b, visited
        children_a, children_b = _children(tree, a), _children(tree, b)
        grid_a = np.repeat(children_a, 2, axis=1)  # left left right right
        grid_b = np.tile(children_b, (1, 2))  # left right left right
        valid = (grid_a >= 0) & (grid_b >= 0)
        valid[:, 2] &= a != b  # (right, left) of one node repeats (left, right)
        a, b = grid_a[valid], grid_b[valid]


def _children(tree: TreeArrays, nodes: Indices) -> Indices:
    """(n, 2) children; a leaf is its own only child, the other entry is -1."""
    leaf = tree.axis[nodes] == LEAF
    return np.stack([np.where(leaf, nodes, 2 * nodes + 1), np.where(leaf, -1, 2 * nodes + 2)], axis=1)


def _add_block(
    tree: TreeArrays, radius: float, a: Indices, b: Indices, offsets: Indices, counts: Array, sums: Array
) -> None:
    """Add the distances between the points of leaves ``a`` (those at ``offsets``) and ``b`` to both sides."""
    rows = tree.start[a, None] + offsets
    columns = tree.start[b, None] + np.arange(tree.end[b[0]] - tree.start[b[0]])
    p, q = tree.points[rows], tree.points[columns]
    squared = np.zeros((len(a), rows.shape[1], columns.shape[1]))
    for m in range(3):
        squared += (p[:, :, None, m] - q[:, None, :, m]) ** 2
    inside = squared <= radius**2
    inside &= rows[:, :, None] != columns[:, None, :]  # v != i
    distance = np.where(inside, np.sqrt(squared), 0.0)
    mirrored = (a != b)[:, None]  # a leaf joined with itself holds each pair twice already
    n = len(counts)
    counts += np.bincount(rows.ravel(), inside.sum(axis=2).ravel(), n)
    sums += np.bincount(rows.ravel(), distance.sum(axis=2).ravel(), n)
    counts += np.bincount(columns.ravel(), (inside.sum(axis=1) * mirrored).ravel(), n)
    sums += np.bincount(columns.ravel(), (distance.sum(axis=1) * mirrored).ravel(), n)


def query_radius(tree: TreeArrays, queries: Array, radii: Array) -> tuple[Indices, Indices, int]:
    """Pairs (query, tree position) within each query's radius, sorted by query; nodes visited."""
    found, visited = [], 0
    for chunk in np.array_split(np.arange(len(queries)), 1 + len(queries) // 8192):
        who, where, seen = _candidates(tree, queries[chunk], radii[chunk])
        squared = ((queries[chunk[who]] - tree.points[where]) ** 2).sum(axis=1)
        inside = squared <= radii[chunk[who]] ** 2
        found.append((chunk[who[inside]], where[inside]))
        visited += seen
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found]), visited


def _candidates(tree: TreeArrays, queries: Array, radii: Array) -> tuple[Indices, Indices, int]:
    """Pairs (query, tree position) of all points in leaves that a ball of each query's radius reaches."""
    who, node = np.arange(len(queries)), np.zeros(len(queries), dtype=np.int64)
    leaf_who, leaf_node, visited = [], [], 0
    while len(who):
        q = queries[who]
        gap = np.maximum(0, np.maximum(tree.lower[node] - q, q - tree.upper[node]))
        near = (gap**2).sum(axis=1) <= radii[who] ** 2
        visited += len(who)
        who, node = who[near], node[near]
        leaf = tree.axis[node] == LEAF
        leaf_who.append(who[leaf])
        leaf_node.append(node[leaf])
        who, node = np.repeat(who[~leaf], 2), (2 * node[~leaf, None] + np.array([1, 2])).ravel()
    all_who, all_node = np.concatenate(leaf_who), np.concatenate(leaf_node)
    by_query = np.argsort(all_who, kind="stable")
    all_who, all_node = all_who[by_query], all_node[by_query]
    sizes = tree.end[all_node] - tree.start[all_node]
    return np.repeat(all_who, sizes), _ranges(tree.start[all_node], sizes), visited


def _ranges(first: Indices, sizes: Indices) -> Indices:
    """Concatenated ranges first[i] .. first[i] + sizes[i]."""
    offset = np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.repeat(first, sizes) + np.arange(sizes.sum()) - offset


def query_knn(tree: TreeArrays, queries: Array, k: int, alive: Mask) -> tuple[Array, Indices, int]:
    """Distances and tree positions (Q, k) of the k nearest points with ``alive`` set, nearest first; nodes visited."""
    distances, positions = np.empty((len(queries), k)), np.empty((len(queries), k), dtype=np.int64)
    visited = 0
    for chunk in np.array_split(np.arange(len(queries)), 1 + len(queries) // 4096):
        q = queries[chunk]
        reach = _knn_bound(tree, q, k, alive)
        who, where, seen = _candidates(tree, q, reach)
        who, where = who[alive[where]], where[alive[where]]
        squared = ((q[who] - tree.points[where]) ** 2).sum(axis=1)
        picked, position = _smallest(len(q), who, where, squared, k)
        distances[chunk], positions[chunk] = np.sqrt(picked), position
        visited += seen
    return distances, positions, visited


def _knn_bound(tree: TreeArrays, queries: Array, k: int, alive: Mask) -> Array:
    """A distance within which each query has k living points: from the block of the tree that the query falls into."""
    node = np.zeros(len(queries), dtype=np.int64)
    while True:
        side = queries[np.arange(len(queries)), np.maximum(tree.axis[node], 0)] >= tree.split[node]
        child = np.minimum(2 * node + 1 + side, len(tree.axis) - 1)
        deeper = (tree.axis[node] >= 0) & (tree.end[child] - tree.start[child] >= 2 * k)
        if not deeper.any():
            break
        node = np.where(deeper, child, node)
    sizes = tree.end[node] - tree.start[node]
    who, where = np.repeat(np.arange(len(queries)), sizes), _ranges(tree.start[node], sizes)
    squared = np.where(alive[where], ((queries[who] - tree.points[where]) ** 2).sum(axis=1), np.inf)
    picked, _ = _smallest(len(queries), who, where, squared, k)
    return np.asarray(np.sqrt(picked[:, -1]) * (1 + 1e-12))


def _smallest(n: int, who: Indices, where: Indices, squared: Array, k: int) -> tuple[Array, Indices]:
    """The k smallest entries of each query's list, ascending (n, k). Lists come sorted by query; inf fills up."""
    counts = np.bincount(who, minlength=n)
    column = np.arange(len(who)) - np.repeat(np.cumsum(counts) - counts, counts)
    width = max(k, int(counts.max()))
    table, place = np.full((n, width), np.inf), np.zeros((n, width), dtype=np.int64)
    table[who, column], place[who, column] = squared, where
    best = np.argpartition(table, k - 1, axis=1)[:, :k]
    best = np.take_along_axis(best, np.argsort(np.take_along_axis(table, best, 1), axis=1, kind="stable"), 1)
    return np.take_along_axis(table, best, 1), np.take_along_axis(place, best, 1)
