"""Contacts float: each is a part of its own, and none sits quite where the drawing has it across the axis.

A contact's walls and edges, however many points see them, fix the port no better than the contact itself is placed.
So what its rows say together is limited to that, in the solution as well as in its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt

from perception.front_map import CELL_M, TOLERANCE_M, FrontMap
from perception.geometry import Array

FLOAT_M = 0.0001
"""Standard deviation of a contact's place, each way across the axis."""
_REACH_M = 0.0025
"""What lies no further from a contact's tip than this moves with it: its walls, and its well."""
_RING_CELLS = 3
_FREE_SHARE = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Floating:
    """Which place belongs to which contact."""

    low: Array
    """(2,) corner of the first cell."""
    number: NDArray[np.int16]
    """(X, Y) the contact's number; 0 where none is."""

    def at(self, xy: Array) -> NDArray[np.int64]:
        """Contact numbers (N,) of places (N, 2) in the port's plane; 0 for none."""
        i, j = np.floor((xy - self.low) / CELL_M).astype(np.int64).T
        wide, high = self.number.shape
        inside = (i >= 0) & (i < wide) & (j >= 0) & (j < high)
        return np.where(inside, self.number[np.where(inside, i, 0), np.where(inside, j, 0)], 0).astype(np.int64)

    def shares(self, xy: Array, across: Array, weight: Array) -> Array:
        """By how much (N,) to lessen the weights (N,) of rows at places (N, 2).

        :param across: (N,) share of each row's direction that lies across the axis, squared.
        """
        number = self.at(xy)
        known = np.maximum(np.bincount(number, 0.5 * weight * across, minlength=1), 0.0)
        share = 1.0 / (1.0 + known * FLOAT_M**2)
        share[0] = 1.0
        return np.asarray(np.where(across > 0.5, share[number], 1.0))


def find_floating(front: FrontMap) -> Floating:
    """The contacts of a port: contact-sized tips that stand free of what is around them."""
    number = np.zeros(front.feature.shape, np.int16)
    for k in range(1, front.features + 1):
        tip = front.feature == k
        around = binary_dilation(tip, iterations=_RING_CELLS) & ~binary_dilation(tip, iterations=_RING_CELLS - 1)
        deeper = front.lowest[around] < float(np.median(front.highest[tip])) - TOLERANCE_M
        if float(np.mean(deeper | np.isnan(front.lowest[around]))) > _FREE_SHARE:
            number[tip] = k
    away, (i, j) = distance_transform_edt(number == 0, return_indices=True)
    return Floating(front.low, np.where(away * CELL_M < _REACH_M, number[i, j], 0).astype(np.int16))
