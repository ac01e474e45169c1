"""What the part and the sweep may do that the model does not say: nuisance parameters of the refinement, with priors.

A built inlet has draft on its walls and its floors are not quite where the drawing has them; an arm vibrates while it
sweeps. Each is a few parameters that the fit may move within what is usual. The pose then rests on what does not depend
on them, and its covariance holds their part of the error.
"""

from __future__ import annotations

import numpy as np

from perception.geometry import Array, Pose
from perception.matching import Matches
from perception.port_model import PortModel

DRAFT_RAD = 0.008
LEVEL_M = 0.00015
VIBRATION_M = 0.00008
KNOT_M = 0.006
SCALE = 0.0004


def columns(pose: Pose, matches: Matches, sweep: Array, direction: Array, model: PortModel) -> tuple[Array, Array]:
    """How much each nuisance parameter moves each distance (N, K), and the parameters' standard deviations (K,).

    :param sweep: (N,) where in the sweep each point was taken, metres.
    :param direction: (3,) unit vector from port to sensor in the prior frame, along which the arm vibrates.
    """
    n, local = matches.normal, matches.local
    wall = 1.0 - np.abs(n[:, 2])
    draft = wall * np.maximum(-local[:, 2], 0.0)
    scale = np.einsum("ij,ij->i", local, n)
    level = model.surface.level[matches.index].astype(np.int64)
    levels = np.zeros((len(local), int(model.surface.level.max()) + 1))
    levels[np.arange(len(local)), level] = 1.0
    shake = _hats(sweep) * (n @ pose.inverse().rotate(direction))[:, None]
    sigma = np.concatenate(
        [[DRAFT_RAD, SCALE], np.full(levels.shape[1] - 1, LEVEL_M), np.full(shake.shape[1], VIBRATION_M)]
    )
    return np.hstack([draft[:, None], scale[:, None], levels[:, 1:], shake]), sigma


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
