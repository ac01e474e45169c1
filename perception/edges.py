"""Equations from where the port's flats end: scan points beyond an edge, and rays that passed through a flat.

A point on a flat beyond its edge, and a ray that went through a flat near its edge and met a deeper surface, both say
how far the edge is from where the pose puts it; the two kinds bound it from its two sides. Only rays that end on a
surface of the port count: what a mixed pixel reports between two surfaces says nothing of either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array
from perception.matching import Matches
from perception.port_model import PortModel

REACH_M = 0.0015
"""Edges further from the point or ray than this are not the ones it speaks of."""
_BELOW_M = 0.001
"""A ray passed through a flat when its point lies this much deeper."""
_ON_SURFACE = 3.0
"""Points within this many standard deviations are on a surface."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeRows:
    """One row for each point or ray on the wrong side of an edge; port frame."""

    local: Array
    """(E, 3) where the point lies, or the ray passed."""
    outward: Array
    """(E, 3) unit direction away from the flat, at its nearest edge."""
    beyond: Array
    """(E,) metres along ``outward`` from the edge; negative for rays, which passed inside it."""
    of: NDArray[np.int64]
    """(E,) number of the match."""


def edge_rows(matches: Matches, model: PortModel, scale_m: float) -> EdgeRows:
    """The rows of matched points with noise ``scale_m`` (1 sigma)."""
    flats, local = model.flats, matches.local
    on = np.flatnonzero(np.abs(matches.distance) < _ON_SURFACE * scale_m)
    facing = matches.normal[on, 2] > 0.97
    level = np.where(facing, flats.level_at(model.surface.points[matches.index[on], 2]), -1)
    points = on[level >= 0]
    found = [_rows(model, level[level >= 0], local[points], points, beyond=True)]
    sight = matches.ray[on]
    for k, height in enumerate(flats.heights):
        deeper = local[on, 2] < height - max(_BELOW_M, 4 * scale_m)
        through = on[deeper]
        share = (height - local[through, 2]) / sight[deeper, 2]
        crossing = local[through] + share[:, None] * sight[deeper]
        found.append(_rows(model, np.full(len(through), k), crossing, through, beyond=False))
    return EdgeRows(*(np.concatenate([getattr(rows, name) for rows in found]) for name in EdgeRows.__slots__))


def _rows(model: PortModel, level: NDArray[np.int64], local: Array, of: NDArray[np.int64], *, beyond: bool) -> EdgeRows:
    """Rows of places that lie on the wrong side of their level's edge, within reach."""
    around = model.flats.around(level, local[:, :2])
    distance = around.beyond()
    wrong = np.flatnonzero(((distance > 0) if beyond else (distance < 0)) & (np.abs(distance) < REACH_M))
    outward = around.outward(wrong)
    told = np.abs(outward).sum(axis=1) > 0.5
    wrong, outward = wrong[told], np.column_stack([outward[told], np.zeros(int(told.sum()))])
    return EdgeRows(local[wrong], outward, distance[wrong], of[wrong])
