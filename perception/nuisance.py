"""What the part and the sweep may do that the model does not say: nuisance parameters of the refinement, with priors.

A built inlet has draft on its walls and its floors are not quite where the drawing has them; an arm vibrates and is not
exactly as fast as it says while it sweeps; edges are rounded and a laser spot has a size. Each is a few parameters that
the fit may move within what is usual. The pose then rests on what does not depend on them, and its covariance holds
their part of the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array

DRAFT_RAD = 0.001
SHRINK = 0.0002
LEVEL_M = 0.0001
SPEED = 0.004
VIBRATION_M = 0.00001
EDGE_M = 0.0002
KNOT_M = 0.008


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What the columns are made from: the equations for the pose, row by row; port frame."""

    local: Array
    """(N, 3) points."""
    along: Array
    """(N, 3) direction in which the row measures: surface normal, or outward from an edge."""
    level: NDArray[np.int64]
    """(N,) number of the flat, 0 for none."""
    edge: NDArray[np.bool_]
    """(N,) whether the row is the distance to an edge."""
    sweep: Array
    """(N,) where in the sweep the point was taken, metres from the sweep's middle."""
    sweep_direction: Array
    """(3,) unit vector of the sweep."""
    view: Array
    """(3,) unit vector towards the sensor."""


def columns(rows: Rows, levels: int) -> tuple[Array, Array]:
    """How much each nuisance parameter moves each distance (N, K), and the parameters' standard deviations (K,).

    :param levels: the model's number of flats off the rim plane.
    """
    plane = ~rows.edge
    n = rows.along
    draft = plane * (1.0 - np.abs(n[:, 2])) * np.maximum(-rows.local[:, 2], 0.0)
    shrink = np.einsum("ij,ij->i", rows.local, n)
    speed = (n @ rows.sweep_direction) * rows.sweep
    hats = _hats(rows.sweep)
    knots = hats.shape[1]
    found = np.zeros((len(n), 4 + levels + 3 * knots))  # filled in place: the matrix is large, and copies cost most
    for k, column in enumerate((draft, shrink, speed, rows.edge)):
        found[:, k] = column
    on_flat = np.flatnonzero(plane & (rows.level > 0))
    found[on_flat, 3 + rows.level[on_flat]] = 1.0
    side = np.cross(rows.view, rows.sweep_direction)
    for k, direction in enumerate((rows.view, rows.sweep_direction, side)):
        first = 4 + levels + k * knots
        np.multiply(hats, (n @ direction)[:, None], out=found[:, first : first + knots])
    sigma = np.concatenate(
        [[DRAFT_RAD, SHRINK, SPEED, EDGE_M], np.full(levels, LEVEL_M), np.full(3 * hats.shape[1], VIBRATION_M)]
    )
    return found, sigma


def _hats(sweep: Array) -> Array:
    """Piecewise linear functions of the sweep with knots ``KNOT_M`` apart, (N, K)."""
    at = (sweep - sweep.min()) / KNOT_M
    count = int(at.max()) + 2
    left = np.minimum(at.astype(np.int64), count - 2)
    rest = at - left
    hats = np.zeros((len(sweep), count))
    rows = np.arange(len(sweep))
    hats[rows, left] = 1.0 - rest
    hats[rows, left + 1] = rest
    return hats
