"""Loops of the adaptive KD-tree that numba compiles. Plain arrays in and out; ``kdtree_numba`` is the way in.

These are the only loops over points in portdock: compiled code is fast just where numpy needs detours.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numba import njit

from perception.geometry import Array
from perception.published.kdtree_numpy import ABSENT, LEAF, Indices, Mask

_STACK = 128
F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """numba's njit with its cache on disk, typed."""
    return cast(F, njit(cache=True)(function))


@compiled
def fill_tree(
    points: Array,
    order: Indices,
    axis: Indices,
    split: Array,
    start: Indices,
    end: Indices,
    lower: Array,
    upper: Array,
    leaf_size: int,
    rule: int,
) -> int:
    """Split nodes from the root down; heap numbering makes a parent come before its children."""
    axis[0], end[0] = LEAF, len(points)
    touched = 0
    level, level_end = 0, 1
    for node in range(len(axis)):
        if node == level_end:
            level, level_end = level + 1, 2 * level_end + 1
        if axis[node] == ABSENT:
            continue
        first, last = start[node], end[node]
        if last - first <= leaf_size:
            continue
        chosen = split_axis(points, first, last, rule, level)
        if chosen < 0:
            continue
        half = first + (last - first) // 2
        select(points, order, first, last - 1, half, chosen)
        touched += last - first
        axis[node], split[node] = chosen, points[half, chosen]
        left = 2 * node + 1
        axis[left], start[left], end[left] = LEAF, first, half
        axis[left + 1], start[left + 1], end[left + 1] = LEAF, half, last
    for node in range(len(axis) - 1, -1, -1):
        if axis[node] == LEAF:
            for i in range(start[node], end[node]):
                for m in range(3):
                    lower[node, m] = min(lower[node, m], points[i, m])
                    upper[node, m] = max(upper[node, m], points[i, m])
        elif axis[node] >= 0:
            for m in range(3):
                lower[node, m] = min(lower[2 * node + 1, m], lower[2 * node + 2, m])
                upper[node, m] = max(upper[2 * node + 1, m], upper[2 * node + 2, m])
    return touched


@compiled
def split_axis(points: Array, first: int, last: int, rule: int, level: int) -> int:
    """The split axis of one node, or -1 if all its points are identical."""
    if rule == 0:
        n = last - first
        m0 = m1 = m2 = 0.0
        for i in range(first, last):
            m0 += points[i, 0]
            m1 += points[i, 1]
            m2 += points[i, 2]
        m0, m1, m2 = m0 / n, m1 / n, m2 / n
        v0 = v1 = v2 = 0.0
        for i in range(first, last):
            v0 += (points[i, 0] - m0) ** 2
            v1 += (points[i, 1] - m1) ** 2
            v2 += (points[i, 2] - m2) ** 2
        best = 0 if v0 >= v1 and v0 >= v2 else (1 if v1 >= v2 else 2)
        # rounding of the mean can leave a tiny variance where all points are equal: compare the points before giving up
        if max(v0, v1, v2) > 1e-18 * (1.0 + m0 * m0 + m1 * m1 + m2 * m2):
            return best
    e0, e1, e2 = extent(points, first, last, 0), extent(points, first, last, 1), extent(points, first, last, 2)
    if max(e0, e1, e2) <= 0.0:
        return -1
    if rule == 1:
        return level % 3
    return 0 if e0 >= e1 and e0 >= e2 else (1 if e1 >= e2 else 2)


@compiled
def extent(points: Array, first: int, last: int, m: int) -> float:
    """Largest less smallest coordinate of a range of points on axis m."""
    low = high = points[first, m]
    for i in range(first + 1, last):
        low, high = min(low, points[i, m]), max(high, points[i, m])
    return float(high - low)


@compiled
def select(points: Array, order: Indices, low: int, high: int, k: int, m: int) -> None:
    """Quickselect on rows low..high: row k gets the value it would have in sorted order."""
    while high > low:
        a, b, c = points[low, m], points[(low + high) >> 1, m], points[high, m]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while points[i, m] < pivot:
                i += 1
            while points[j, m] > pivot:
                j -= 1
            if i <= j:
                for n in range(3):
                    points[i, n], points[j, n] = points[j, n], points[i, n]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            return


@compiled
def self_join(
    points: Array,
    axis: Indices,
    start: Indices,
    end: Indices,
    lower: Array,
    upper: Array,
    leaves: Indices,
    radius: float,
    counts: Indices,
    sums: Array,
) -> int:
    """Each unordered pair of points once: from each leaf, visit the leaves that come later in the heap and are near."""
    squared = radius * radius
    stack = np.empty(_STACK, dtype=np.int64)
    visited = 0
    for leaf in leaves:
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            visited += 1
            gap = 0.0
            for m in range(3):
                d = max(lower[leaf, m] - upper[node, m], lower[node, m] - upper[leaf, m])
                if d > 0.0:
                    gap += d * d
            if gap > squared:
                continue
            if axis[node] >= 0:
                stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
                top += 2
            elif node >= leaf:
                for i in range(start[leaf], end[leaf]):
                    x, y, z = points[i, 0], points[i, 1], points[i, 2]
                    count, total = 0, 0.0
                    for j in range(i + 1 if node == leaf else start[node], end[node]):
                        d2 = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 + (points[j, 2] - z) ** 2
                        if d2 <= squared:
                            d = np.sqrt(d2)
                            count += 1
                            total += d
                            counts[j] += 1
                            sums[j] += d
                    counts[i] += count
                    sums[i] += total
    return visited


@compiled
def gap(lower: Array, upper: Array, node: int, x: float, y: float, z: float) -> float:
    """Squared distance of a point to a node's box."""
    a = max(lower[node, 0] - x, x - upper[node, 0], 0.0)
    b = max(lower[node, 1] - y, y - upper[node, 1], 0.0)
    c = max(lower[node, 2] - z, z - upper[node, 2], 0.0)
    return float(a * a + b * b + c * c)


@compiled
def radius(
    points: Array,
    axis: Indices,
    start: Indices,
    end: Indices,
    lower: Array,
    upper: Array,
    queries: Array,
    radii: Array,
    cursor: Indices,
    where: Indices,
    fill: bool,
) -> int:
    """Count, or where ``fill`` is set write down, the points within each query's radius; advances ``cursor``."""
    stack = np.empty(_STACK, dtype=np.int64)
    visited = 0
    for q in range(len(queries)):
        x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
        squared = radii[q] * radii[q]
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            visited += 1
            if gap(lower, upper, node, x, y, z) > squared:
                continue
            if axis[node] >= 0:
                stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
                top += 2
                continue
            for j in range(start[node], end[node]):
                if (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 + (points[j, 2] - z) ** 2 <= squared:
                    if fill:
                        where[cursor[q]] = j
                    cursor[q] += 1
    return visited


@compiled
def knn(
    points: Array,
    axis: Indices,
    start: Indices,
    end: Indices,
    lower: Array,
    upper: Array,
    queries: Array,
    alive: Mask,
    squared: Array,
    where: Indices,
) -> int:
    """Depth first, nearer child first; each query's best k stand sorted in its row of the result.

    A query's k-th distance is at most that of the query before plus the step between the two, so where queries come in
    tree order the row starts with a bound that is nearly right.
    """
    stack, gaps = np.empty(_STACK, dtype=np.int64), np.empty(_STACK)
    visited, k = 0, squared.shape[1]
    for q in range(len(queries)):
        x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
        best, place = squared[q], where[q]
        if q > 0:
            step = (x - queries[q - 1, 0]) ** 2 + (y - queries[q - 1, 1]) ** 2 + (z - queries[q - 1, 2]) ** 2
            bound = (np.sqrt(step) + np.sqrt(squared[q - 1, k - 1])) ** 2 * (1.0 + 1e-9)
            if bound > 1e-200:  # zero: all identical, and the row takes only what is below its last entry
                best[:] = bound
        worst, top = best[k - 1], 1
        stack[0], gaps[0] = 0, 0.0
        while top > 0:
            top -= 1
            node = stack[top]
            if gaps[top] > worst:
                continue
            visited += 1
            if axis[node] >= 0:
                near, far = 2 * node + 1, 2 * node + 2
                near_gap, far_gap = gap(lower, upper, near, x, y, z), gap(lower, upper, far, x, y, z)
                if near_gap > far_gap:
                    near, far, near_gap, far_gap = far, near, far_gap, near_gap
                if far_gap <= worst:
                    stack[top], gaps[top] = far, far_gap
                    top += 1
                stack[top], gaps[top] = near, near_gap
                top += 1
                continue
            for j in range(start[node], end[node]):
                d2 = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2 + (points[j, 2] - z) ** 2
                if d2 < worst and alive[j]:
                    insert(best, place, d2, j)
                    worst = best[k - 1]
    return visited


@compiled
def insert(best: Array, place: Indices, d2: float, j: int) -> None:
    """Put (d2, j) at its place in the sorted row; the last entry falls out."""
    i = len(best) - 1
    while i > 0 and best[i - 1] > d2:
        best[i], place[i] = best[i - 1], place[i - 1]
        i -= 1
    best[i], place[i] = d2, j
