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
ACROSS_M = 0.00001
ACROSS_SIGMAS = 0.2
"""Standard deviation across the axis that no residual shows, and its share of the noise: mixed pixels and shadows
displace what bounds the port sideways, all of it in one direction."""
LEVER_M = 0.025
"""How far from the axis such a displacement acts when it turns the port."""
TILT_SIGMAS = 0.03
"""The same for what tilts it, at the same lever: vibration along the axis that is slow enough to look like a tilt."""


def covariance(refined: Refined) -> Array:
    """(6, 6) covariance of translation (m) then rotation vector (rad), in the port frame."""
    inverse = np.linalg.inv(refined.information)
    patch = np.unique(_patches(refined), return_inverse=True)[1]
    count = int(patch.max()) + 1
    order = np.argsort(patch, kind="stable")
    pull = refined.jacobian[order] * (refined.weight * refined.distance)[order, None]
    sums = np.add.reduceat(pull, np.searchsorted(patch[order], np.arange(count)), axis=0)
    clustered = inverse @ (sums.T @ sums) @ inverse * (count / max(count - 6, 1))
    across = ACROSS_M + ACROSS_SIGMAS * refined.scale_m
    tilt = TILT_SIGMAS * refined.scale_m / LEVER_M
    along = max(0.0, abs(refined.depth_dispute_m) - BUILT_M)
    unseen = np.square([across, across, along, tilt, tilt, across / LEVER_M])
    return np.asarray((inverse + clustered)[:6, :6] + np.diag(unseen))


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
