"""What the part and the sweep may do that the model does not say: nuisance parameters of the refinement, with priors.

A built inlet is not quite as large as drawn, nor are its floors where the drawing has them; an arm vibrates along the
line of sight and is not exactly as fast as it says while it sweeps. Each is a few parameters that the fit of height and
tilt may move within what is usual. The pose then rests on what does not depend on them, and its covariance holds their
part of the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array

SHRINK = 0.0002
LEVEL_M = 0.0001
SPEED = 0.004
"""Standard deviation of the sweep's relative speed error."""
VIBRATION_M = 0.00001
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
    n = rows.along
    hats = _hats(rows.sweep)
    knots = hats.shape[1]
    found = np.zeros((len(n), 2 + levels + knots))  # filled in place: the matrix is large, and copies cost most
    found[:, 0] = np.einsum("ij,ij->i", rows.local, n)  # shrink
    found[:, 1] = (n @ rows.sweep_direction) * rows.sweep  # speed
    on_flat = np.flatnonzero(rows.level > 0)
    found[on_flat, 1 + rows.level[on_flat]] = 1.0
    np.multiply(hats, (n @ rows.view)[:, None], out=found[:, 2 + levels :])
    return found, np.concatenate([[SHRINK, SPEED], np.full(levels, LEVEL_M), np.full(knots, VIBRATION_M)])


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
