"""Where a port roughly is, from a scan as noisy as a time-of-flight range finder's: good to about a centimetre.

A single range is off by as much as the port is deep, but a scan has thousands. They are averaged in cells of a front
view, the vehicle's skin is taken off as a curved surface, and the port's own relief is slid over what is left: where
the two go up and down together (correlation over the cells under the port) is the port. What all ranges of a surface
share cancels out. Orientation is not estimated: the prior's is kept. Nothing here is good enough to dock with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.errors import EmptyScanError
from perception.estimate import Prior
from perception.geometry import Array, Pose
from perception.scan import Cloud

CELL_M = 0.004
LEAST_CORRELATION = 0.25
"""A skin without any pocket reaches 0.2 by noise. An empty pocket passes: telling it apart takes a precise scan."""
FRONT_M = 0.001
"""Cells of the port in which the foremost surface counts: a beam does not see the floor of a narrow well."""
LEAST_COVER = 0.7
"""Share of the port's cells that must have been seen."""
LEAST_POINTS = 2000
_OUTSIDE_M = 0.08
"""Beyond the prior along the axis, still looked at: the skin before the port, the floor of its wells behind."""
_TRIMS = 4


@dataclass(frozen=True, slots=True)
class RoughPlace:
    """The best place of the port in a rough scan."""

    T_ref_port: Pose
    """With the prior's orientation."""
    correlation: float
    """Of the scan's relief with the port's, -1 to 1."""
    points: int
    """How many ranges were looked at."""

    @property
    def found(self) -> bool:
        """Whether that is a port and not noise."""
        return self.correlation >= LEAST_CORRELATION


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """A front view: heights averaged in cells, and how many points each holds."""

    height: Array
    """(X, Y), 0 where there is none."""
    count: Array
    """(X, Y)."""
    low: Array
    """(2,) corner of the first cell."""


def find_roughly(cloud: Cloud, surface: Array, prior: Prior) -> RoughPlace:
    """The port's place within the prior's bounds.

    :param surface: samples (N, 3) of what can be seen of the port from the front, in its frame.
    :raises EmptyScanError: hardly a point lies where the port may be
    """
    points = prior.T_ref_port.inverse().apply(cloud.points)
    reach = np.abs(surface[:, :2]).max(axis=0) + prior.lateral_m
    near = (np.abs(points[:, :2]) < reach).all(axis=1) & (np.abs(points[:, 2]) < prior.along_m + _OUTSIDE_M)
    points = points[near]
    if len(points) < LEAST_POINTS:
        raise EmptyScanError(
            f"the rough scan has {len(points)} points where the port may be, {LEAST_POINTS} are needed"
        )
    relief = _gridded(np.column_stack([points[:, :2], points[:, 2] - _skin(points)]), CELL_M)
    front = _front(surface)
    port = _gridded(front, CELL_M)
    correlation = _correlation(relief, port, prior.lateral_m)
    i, j = np.unravel_index(int(correlation.argmax()), correlation.shape)
    shift = relief.low - port.low + (np.array([i, j]) - np.array(port.height.shape) + 1) * CELL_M
    under = _heights_under(points, front, shift)
    place = Pose(np.eye(3), np.array([*shift, under]))
    return RoughPlace(prior.T_ref_port @ place, float(correlation[i, j]), len(points))


def _front(surface: Array) -> Array:
    """The foremost points (K, 3) of samples (N, 3), one for each cell of FRONT_M."""
    low = surface[:, :2].min(axis=0)
    at = np.floor((surface[:, :2] - low) / FRONT_M).astype(np.int64)
    top = np.full(at.max(axis=0) + 1, -np.inf)
    np.maximum.at(top, (at[:, 0], at[:, 1]), surface[:, 2])
    i, j = np.nonzero(np.isfinite(top))
    return np.column_stack([low + (np.column_stack([i, j]) + 0.5) * FRONT_M, top[i, j]])


def _gridded(points: Array, cell_m: float) -> _Grid:
    low = np.floor(points[:, :2].min(axis=0) / cell_m) * cell_m
    at = np.floor((points[:, :2] - low) / cell_m).astype(np.int64)
    shape = at.max(axis=0) + 1
    flat = np.ravel_multi_index((at[:, 0], at[:, 1]), tuple(shape))
    count = np.bincount(flat, minlength=int(shape.prod())).astype(np.float64)
    total = np.bincount(flat, weights=points[:, 2], minlength=int(shape.prod()))
    height = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    return _Grid(height.reshape(shape), count.reshape(shape), low)


def _skin(points: Array) -> Array:
    """Height (N,) of the vehicle's skin under each point: a quadratic surface, fitted to what is not sunk below it."""
    x, y, z = points.T
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    kept = np.ones(len(z), bool)
    for _ in range(_TRIMS):
        fitted = terms @ np.linalg.lstsq(terms[kept], z[kept], rcond=None)[0]
        off = z - fitted
        spread = 1.4826 * float(np.median(np.abs(off[kept] - np.median(off[kept]))))
        kept = np.abs(off) < 2.0 * spread
    return np.asarray(fitted)


def _correlation(scan: _Grid, port: _Grid, lateral_m: float) -> Array:
    """Pearson's correlation of both reliefs with the port at each shift, each cell by its points; -1 where excluded."""
    from scipy.signal import correlate  # takes a second to import, and only a coarse stage needs it

    mask = (port.count > 0).astype(np.float64)
    shape = port.height * mask

    def slid(values: Array, template: Array) -> Array:
        return np.asarray(correlate(values, template, mode="full", method="fft"))

    n = np.maximum(slid(scan.count, mask), 1e-9)
    cover = slid((scan.count > 0).astype(np.float64), mask) / mask.sum()
    z, zz = slid(scan.count * scan.height, mask) / n, slid(scan.count * scan.height**2, mask) / n
    t, tt = slid(scan.count, shape) / n, slid(scan.count, shape * port.height) / n
    zt = slid(scan.count * scan.height, shape) / n
    spread = np.sqrt(np.maximum(zz - z * z, 1e-12) * np.maximum(tt - t * t, 1e-12))
    result = (zt - z * t) / spread
    rows, columns = (np.arange(size) for size in result.shape)
    x = scan.low[0] - port.low[0] + (rows - port.height.shape[0] + 1) * CELL_M
    y = scan.low[1] - port.low[1] + (columns - port.height.shape[1] + 1) * CELL_M
    outside = np.hypot(x[:, None], y[None, :]) > lateral_m
    return np.where(outside | (cover < LEAST_COVER), -1.0, result)


def _heights_under(points: Array, front: Array, shift: Array) -> float:
    """How far along the axis the port sits: mean difference of measured heights and its own, cell by cell."""
    scan, port = _gridded(points - np.array([*shift, 0.0]), CELL_M), _gridded(front, CELL_M)
    offset = np.round((port.low - scan.low) / CELL_M).astype(np.int64)
    i, j = np.nonzero(port.count)
    inside = (i + offset[0] >= 0) & (j + offset[1] >= 0)
    inside &= (i + offset[0] < scan.count.shape[0]) & (j + offset[1] < scan.count.shape[1])
    i, j = i[inside], j[inside]
    weight = scan.count[i + offset[0], j + offset[1]]
    difference = scan.height[i + offset[0], j + offset[1]] - port.height[i, j]
    return float(np.average(difference, weights=weight))
