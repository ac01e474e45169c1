"""How far the pose may be off: from the geometry of the points and from how the residuals hang together.

Point noise alone gives inv(H). What vibration, speed errors and the part's own tolerances add is not independent from
point to point, and shows as residuals that agree within a neighbourhood. The sandwich estimator with one cluster for
each patch of surface (Liang and Zeger, Biometrika 73, 1986) counts each patch as one observation.
"""

from __future__ import annotations

import numpy as np

from perception.geometry import Array
from perception.rays import ACROSS
from perception.refine import Refined
from perception.upright import UPRIGHT

PATCH_M = 0.006
BUILT_M = 0.0002
"""Flats that are at odds by no more are as parts are built; by more, and which of them is right is not known."""
SWEEP_M, SWEEP_SIGMAS = 0.00001, 0.15
LINE_SIGMAS = 0.10
"""Standard deviation across the axis that no residual shows, and its share of the noise: along the sweep, where
vibration acts and shadows fall to one side, and along the laser's line."""
SPEED_LEAST, SPEED_SHARE = 0.0012, 1.0
"""Standard deviation of the sweep's relative speed error that the port's own length does not show, and what more of it
there is, as a share of the stretch that it does show."""
LEVER_M = 0.025
"""How far from the axis such a displacement acts when it turns the port."""
ROLL_SIGMAS = 0.08
TILT_SIGMAS = 0.02
"""The same at that lever for the roll, and for what tilts the port up or down along the sweep: vibration along the axis
that is slow enough looks like a tilt. All of them fit the errors of 108 nominal, 107 hard and 148 extreme scans
(seeds 70 and 71)."""


def covariance(refined: Refined) -> Array:
    """(6, 6) covariance of translation (m) then rotation vector (rad), in the port frame."""
    upright, rays = refined.upright, refined.rays
    raised, across = np.linalg.inv(upright.information)[:3], np.linalg.inv(rays.known)
    pulls = np.zeros((len(upright.local) + len(rays.local), 6))
    pulls[: len(upright.local), UPRIGHT] = upright.jacobian @ raised.T * (upright.weight * upright.distance)[:, None]
    pulls[len(upright.local) :, ACROSS] = -rays.pulls @ across
    patch = np.unique(_patches(np.vstack([upright.local, rays.local])), return_inverse=True)[1]
    count = int(patch.max()) + 1
    order = np.argsort(patch, kind="stable")
    sums = np.add.reduceat(pulls[order], np.searchsorted(patch[order], np.arange(count)), axis=0)
    found = sums.T @ sums * (count / max(count - 6, 1)) + _unseen(refined)
    found[np.ix_(UPRIGHT, UPRIGHT)] += raised[:, :3]
    found[np.ix_(ACROSS, ACROSS)] += across
    return np.asarray(found)


def _unseen(refined: Refined) -> Array:
    """(6, 6) what no residual shows."""
    aslant = float(np.hypot(*refined.sweep[:2]))
    x, y = refined.sweep[:2] / aslant if aslant > 0.1 else (0.0, 1.0)
    turned = np.array([[x, -y], [y, x]])  # columns: along the sweep, along the laser's line
    across = np.array([SWEEP_M + SWEEP_SIGMAS * refined.scale_m, LINE_SIGMAS * refined.scale_m])
    tilt = np.array([0.0, TILT_SIGMAS * refined.scale_m / LEVER_M])  # about each of the two
    found = np.zeros((6, 6))
    found[:2, :2] = turned @ np.diag(across**2) @ turned.T
    speed = np.hypot(SPEED_LEAST, SPEED_SHARE * refined.stretch.share) * refined.stretch.port_at_m
    found[:3, :3] += np.outer(refined.sweep, refined.sweep) * speed**2
    found[2, 2] += max(0.0, abs(refined.depth_dispute_m) - BUILT_M) ** 2
    found[3:5, 3:5] = turned @ np.diag(tilt**2) @ turned.T
    found[5, 5] = ((SWEEP_M + ROLL_SIGMAS * refined.scale_m) / LEVER_M) ** 2
    return found


def _patches(local: Array) -> Array:
    """One number for each point's (N, 3) cell."""
    cell = np.floor(local / PATCH_M).astype(np.int64)
    cell -= cell.min(axis=0)
    size = cell.max(axis=0) + 1
    return np.asarray((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2])
