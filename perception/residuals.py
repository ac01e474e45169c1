"""What a distance to the CAD is worth: the scan's noise on flats and walls, as it shows itself, and robust weights."""

from __future__ import annotations

import numpy as np

from perception.errors import DegenerateCloudError
from perception.geometry import Array, Pose
from perception.matching import Matches
from perception.port_model import PortModel

_MIN_SCALE_M = 0.00003
_TUKEY = 4.0
"""Points further off than this many robust standard deviations have no weight."""
_EDGE_SIGMAS = 2.5
"""A point nearer to an edge than this many standard deviations may belong to either side."""
_WALL_SHARE = (0.4, 1.1)
"""Least and greatest noise of a wall's points, as a share of the noise on flats."""
_LEVER_M = 0.03
"""How far from the port's origin a turn counts as a shift."""


def robust_scale(distance: Array, previous: float) -> float:
    """Standard deviation from the median absolute distance of the points within reach of the previous scale."""
    close = np.abs(distance[np.abs(distance) < 5 * previous])
    if len(close) < 30:
        return previous
    # Not faster than a third for each round: a gate that closes at once traps the pose where it happens to be.
    return float(np.clip(1.4826 * np.median(close), max(_MIN_SCALE_M, 0.67 * previous), previous))


def wall_scale(matches: Matches, scale: float) -> float:
    """Standard deviation of the distances to walls, as the scan itself shows it.

    Noise along the ray would leave a grazed wall measured better than a flat, but not every scanner's noise acts so; a
    gate too narrow for it throws good points away with the mixed pixels.
    """
    away = np.abs(matches.distance[np.abs(matches.normal[:, 2]) < 0.5])
    away = away[away < 5 * scale]
    least, most = _WALL_SHARE
    seen = 1.4826 * float(np.median(away)) if len(away) >= 30 else scale
    return float(np.clip(seen, least * scale, most * scale))


def surface_weights(matches: Matches, model: PortModel, scale: float, gate: float) -> Array:
    """(N,) weights of the distances to surfaces, 1/m2."""
    taper = np.clip(model.surface.edge_m[matches.index] / (_EDGE_SIGMAS * scale) - 0.5, 0.0, 1.0)
    wall = 1.0 - np.abs(matches.normal[:, 2])
    sigma = np.sqrt(scale**2 * (1.0 - wall) + wall_scale(matches, scale) ** 2 * wall)
    weight = tukey(matches.distance / sigma, max(_TUKEY, gate / scale)) * taper / sigma**2
    return np.asarray(weight * model.decides[matches.index])


def tukey(residual: Array, gate: float) -> Array:
    """Tukey's biweight: 1 at 0, falling to 0 at the gate."""
    u = residual / gate
    return np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0)


def solved(information: Array, gradient: Array, turns: slice) -> Array:
    """The pose's numbers of the solution of the normal equations; nuisances follow them.

    :param turns: which of the pose's numbers are rotations; they are its last.
    :raises DegenerateCloudError: the equations leave one of them open.
    """
    pose = turns.stop
    scaling = np.ones(pose)
    scaling[turns] = 1 / _LEVER_M
    values = np.linalg.eigvalsh(information[:pose, :pose] * np.outer(scaling, scaling))
    if values[0] < 1e-6 * max(values[-1], 1e-12):
        raise DegenerateCloudError("the points near the port leave its pose undetermined in at least one direction")
    return np.asarray(np.linalg.solve(information, -gradient)[:pose])


def moved(pose: Pose, step: Array) -> Pose:
    """``step`` brings the scan onto the model, so the model moves by its inverse."""
    bounded = step.copy()
    bounded[3:] *= min(1.0, 0.05 / max(float(np.linalg.norm(step[3:])), 1e-12))
    return pose @ Pose.from_rotvec(bounded[3:], bounded[:3]).inverse()
