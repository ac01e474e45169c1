"""How far the pose may be off: from the geometry of the points and from how the residuals hang together.

Point noise alone gives inv(H). What vibration, speed errors and the part's own tolerances add is not independent from
point to point, and shows as residuals that agree within a neighbourhood. The sandwich estimator with one cluster for
each patch of surface (Liang and Zeger, Biometrika 73, 1986) counts each patch as one observation.
"""

from __future__ import annotations

import numpy as np

from perception.geometry import Array
from perception.refine import Refined

PATCH_M = 0.006
BUILT_M = 0.0002
"""Flats that are at odds by no more are as parts are built; by more, and which of them is right is not known."""
SWEEP_M, SWEEP_SIGMAS = 0.00001, 0.17
LINE_SIGMAS = 0.05
"""Standard deviation across the axis that no residual shows, and its share of the noise: along the sweep, where speed
and vibration act and shadows fall to one side, and along the laser's line."""
LEVER_M = 0.025
"""How far from the axis such a displacement acts when it turns the port."""
ROLL_SIGMAS = 0.05
TILT_SIGMAS = 0.02
"""The same at that lever for the roll, and for what tilts the port up or down along the sweep: vibration along the axis
that is slow enough looks like a tilt. All of them fit the errors of 252 nominal and hard scans (seeds 60 and 61)."""


def covariance(refined: Refined) -> Array:
    """(6, 6) covariance of translation (m) then rotation vector (rad), in the port frame."""
    inverse = np.linalg.inv(refined.information)
    patch = np.unique(_patches(refined), return_inverse=True)[1]
    count = int(patch.max()) + 1
    order = np.argsort(patch, kind="stable")
    pull = refined.jacobian[order] * (refined.weight * refined.distance)[order, None]
    sums = np.add.reduceat(pull, np.searchsorted(patch[order], np.arange(count)), axis=0)
    clustered = inverse @ (sums.T @ sums) @ inverse * (count / max(count - 6, 1))
    return np.asarray((inverse + clustered)[:6, :6] + _unseen(refined))


def _unseen(refined: Refined) -> Array:
    """(6, 6) what no residual shows."""
    aslant = float(np.hypot(*refined.sweep[:2]))
    x, y = refined.sweep[:2] / aslant if aslant > 0.1 else (0.0, 1.0)
    turned = np.array([[x, -y], [y, x]])  # columns: along the sweep, along the laser's line
    across = np.array([SWEEP_M + SWEEP_SIGMAS * refined.scale_m, LINE_SIGMAS * refined.scale_m])
    tilt = np.array([0.0, TILT_SIGMAS * refined.scale_m / LEVER_M])  # about each of the two
    found = np.zeros((6, 6))
    found[:2, :2] = turned @ np.diag(across**2) @ turned.T
    found[2, 2] = max(0.0, abs(refined.depth_dispute_m) - BUILT_M) ** 2
    found[3:5, 3:5] = turned @ np.diag(tilt**2) @ turned.T
    found[5, 5] = ((SWEEP_M + ROLL_SIGMAS * refined.scale_m) / LEVER_M) ** 2
    return found


def _patches(refined: Refined) -> Array:
    """One number for each point's cell of surface and facing direction."""
    cell = np.floor(refined.local / PATCH_M).astype(np.int64)
    facing = np.round(refined.jacobian[:, :3]).astype(np.int64) + 1
    columns = np.column_stack([cell - cell.min(axis=0), facing])
    size = columns.max(axis=0) + 1
    flat: Array = np.zeros(len(columns), dtype=np.int64)
    for k in range(columns.shape[1]):
        flat = flat * size[k] + columns[:, k]
    return flat
