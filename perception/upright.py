"""Height and tilt of a port whose place across the axis and roll are known: every surface, weighed robustly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.crop import Scene
from perception.errors import DegenerateCloudError
from perception.geometry import Array, Pose
from perception.matching import Matches, Measured, match
from perception.nuisance import Rows, columns
from perception.port_model import PortModel
from perception.residuals import moved, robust_scale, solved, surface_weights

UPRIGHT = [2, 3, 4]
"""Height and tilt among a motion's six numbers (translation, rotation vector)."""
_GATE_M = 0.00005


@dataclass(frozen=True, slots=True, eq=False)
class Upright:
    """The pose and the equations that gave its height and tilt; N points, K nuisance parameters."""

    T_prior_port: Pose
    jacobian: Array
    """(N, 3 + K): the distances by height (m) and tilt (rad) in the port frame, and by nuisances."""
    distance: Array
    """(N,) signed distances to the surface, metres."""
    weight: Array
    """(N,) weights of the equations, 1/m2."""
    precision: Array
    """(3 + K,) prior information of each parameter; 0 for the pose."""
    local: Array
    """(N, 3) the points in the port frame."""
    scale_m: float
    """Robust standard deviation of the distances."""

    @property
    def rms_m(self) -> float:
        """Weighted root mean square distance to the surface."""
        return float(np.sqrt((self.weight * self.distance**2).sum() / max(self.weight.sum(), 1e-12)))

    @property
    def information(self) -> Array:
        """(3 + K, 3 + K) normal matrix with the priors."""
        scaled = self.jacobian * np.sqrt(self.weight)[:, None]
        return np.asarray(scaled.T @ scaled + np.diag(self.precision))


def set_upright(
    pose: Pose, measured: Measured, scene: Scene, model: PortModel, scale_m: float, rounds: int, threads: int
) -> Upright:
    """``pose`` (T_prior_port) raised and tilted to where the surfaces fit. Raises DegenerateCloudError."""
    found: Upright | None = None
    for _ in range(rounds):
        matches = match(pose, measured, model, threads)
        if not len(matches.kept):
            raise DegenerateCloudError("no scan point near the port faces as its surface does")
        scale_m = robust_scale(matches.distance, previous=scale_m)
        found = _equations(pose, matches, measured, scene, model, scale_m)
        step = np.zeros(6)
        gradient = (found.weight * found.distance) @ found.jacobian
        step[UPRIGHT] = solved(found.information, gradient, slice(1, 3))
        pose = moved(pose, step)
    assert found is not None  # there is a round
    return Upright(pose, found.jacobian, found.distance, found.weight, found.precision, found.local, found.scale_m)


def _equations(
    pose: Pose, matches: Matches, measured: Measured, scene: Scene, model: PortModel, scale_m: float
) -> Upright:
    """A row for each point, with columns for what part and sweep may do that the model does not say."""
    towards = pose.inverse().apply(np.median(measured.origins, axis=0))
    direction = pose.inverse().rotate(scene.sweep_direction)
    view = towards - (towards @ direction) * direction
    rows = Rows(
        matches.local,
        matches.normal,
        model.surface.level[matches.index].astype(np.int64),
        (measured.origins[matches.kept] - scene.sweep_middle) @ scene.sweep_direction,
        direction,
        view / np.linalg.norm(view),
    )
    nuisances, sigma = columns(rows, int(model.surface.level.max()))
    motion = np.hstack([matches.normal, np.cross(matches.local, matches.normal)])
    return Upright(
        pose,
        np.hstack([motion[:, UPRIGHT], nuisances]),
        matches.distance,
        surface_weights(matches, model, scale_m, _GATE_M),
        np.concatenate([np.zeros(3), sigma**-2]),
        matches.local,
        scale_m,
    )
