"""Where the mating axis may point: the modes of the scan's normals inside the prior's tilt cone.

Flange, rim, cavity floor and pin tips of a port all face along its axis, so each votes for it; the car's panel votes
for its own normal, which is one more hypothesis and does no harm.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from perception.geometry import Array

_BIN_RAD = float(np.deg2rad(0.75))
_SEPARATION_RAD = float(np.deg2rad(3.0))
_MARGIN_RAD = float(np.deg2rad(3.0))


def axis_hypotheses(normals: Array, tilt_rad: float, count: int) -> Array:
    """Unit vectors (K, 3), K <= count, strongest first; the prior's axis is +z.

    :param normals: (N, 3) unit normals of the thinned scan in the prior frame.
    :param tilt_rad: largest angle between the prior's and the true axis.
    """
    limit = tilt_rad + _MARGIN_RAD
    facing = normals[normals[:, 2] > np.cos(limit + _SEPARATION_RAD)]
    slope = facing[:, :2] / facing[:, 2:]
    reach = np.tan(limit) + 3 * _BIN_RAD
    bins = int(2 * reach / _BIN_RAD) + 1
    votes, edges, _ = np.histogram2d(slope[:, 0], slope[:, 1], bins=bins, range=[[-reach, reach]] * 2)
    smooth = gaussian_filter(votes, 1.3)
    peak = (smooth == maximum_filter(smooth, int(_SEPARATION_RAD / _BIN_RAD) | 1)) & (smooth > 1.0)
    where = np.argwhere(peak)
    order = np.argsort(-smooth[peak])
    centres = 0.5 * (edges[:-1] + edges[1:])
    found = list[Array]()
    for i, j in where[order]:
        mode = _mean_shift(slope, np.array([centres[i], centres[j]]))
        far = all(np.linalg.norm(mode - other) > 0.6 * _SEPARATION_RAD for other in found)
        if far and np.linalg.norm(mode) < np.tan(limit):
            found.append(mode)
        if len(found) == count:
            break
    if not found:
        found = [np.zeros(2)]
    axes = np.column_stack([np.array(found), np.ones(len(found))])
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def _mean_shift(slope: Array, mode: Array) -> Array:
    for _ in range(4):
        near = np.linalg.norm(slope - mode, axis=1) < np.deg2rad(2.0)
        if not near.any():
            break
        mode = slope[near].mean(axis=0)
    return mode
