"""From an aligned candidate to a pose that is right to some tenths of a millimetre, by reweighted point-to-plane.

Every surface and edge near the port pulls at it. The gate starts wide and closes; it may not close at once, since a
pose half a millimetre off sideways sees its few wall points as outliers among the many on flats that fit already.
"""

from __future__ import annotations

import numpy as np

from perception.edges import edge_rows
from perception.errors import DegenerateCloudError
from perception.geometry import Array, Pose
from perception.matching import Matches, Measured, match
from perception.port_model import PortModel
from perception.residuals import moved, robust_scale, solved, surface_weights, tukey
from perception.sideways import settle_sideways

_ROUNDS = 6
_POINTS = 4000
_FIRST_SCALE_M, _SIDEWAYS_SCALE_M = 0.0005, 0.0002
"""Noise taken for granted before the scan's own is known."""
_FIRST_GATE_M, _GATE_SHRINK = 0.0015, 0.6
_EDGE_NOISE_M = 0.0001
"""Standard deviation of where an edge seems to be: the scan's spacing, the part's roundings, vibration."""
_EDGE_GATE_M = 0.0004
"""A point further than this on the wrong side of an edge is something else."""
_EDGE_LEAST_M = 0.00002
"""Below this the least-absolute weights stop growing."""
_EDGES_M = 0.00003
"""All edges together fix the port sideways no better than this: what makes an edge look displaced is common to many."""


def approach(start: Pose, measured: Measured, model: PortModel, threads: int) -> tuple[Pose, float]:
    """(T_prior_port, scale in metres): roughly right in all six directions, and the noise of the points."""
    some = measured.at_most(_POINTS)
    pose, scale = settle_sideways(start, measured, model, _SIDEWAYS_SCALE_M), _FIRST_SCALE_M
    for round_ in range(_ROUNDS):
        matches = match(pose, some, model, threads)
        scale = robust_scale(matches.distance, previous=scale)
        equations = _normal_equations(matches, model, scale, _FIRST_GATE_M * _GATE_SHRINK**round_)
        try:
            pose = moved(pose, solved(*equations, slice(3, 6)))
        except DegenerateCloudError:
            break  # so few points may leave the roll open where all of them do not
    return pose, scale


def _normal_equations(matches: Matches, model: PortModel, scale: float, gate: float) -> tuple[Array, Array]:
    """(information, gradient) of all surfaces, and of the points and rays on the wrong side of an edge."""
    edges = edge_rows(matches, model, scale)
    # Least absolute, not least squares: a few false points far beyond an edge must not outvote many just beyond it.
    edge_weight = tukey(edges.beyond, max(_EDGE_GATE_M, gate))
    edge_weight /= _EDGE_NOISE_M * np.maximum(np.abs(edges.beyond), _EDGE_LEAST_M)
    edge_weight *= min(1.0, _EDGES_M**-2 / max(0.5 * float(edge_weight.sum()), 1e-9))
    along, local = np.vstack([matches.normal, edges.outward]), np.vstack([matches.local, edges.local])
    weight = np.concatenate([surface_weights(matches, model, scale, gate), edge_weight])
    weight *= model.floating.shares(local[:, :2], 1.0 - along[:, 2] ** 2, weight)
    jacobian = np.hstack([along, np.cross(local, along)])
    weighted = jacobian * weight[:, None]
    return jacobian.T @ weighted, np.concatenate([matches.distance, edges.beyond]) @ weighted
