"""By how much the sweep was faster or slower than the arm said: the scan is longer or shorter along it than the port.

A port beside the middle of the sweep then seems displaced by that share of its distance from the middle, which nothing
but its own length shows. The rays say how long it is (``rays``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.crop import Scene
from perception.geometry import Array, Pose
from perception.nuisance import SPEED
from perception.port_model import PortModel
from perception.rays import Rays, ray_costs

BELIEVED = 0.4
"""Of a stretch that is seen: the rest is vibration between the port's ends, and parts that are not as long as drawn."""
_STEPS = (0.003, 0.001)
_AROUND = np.arange(-2.0, 3.0)
_PSEUDO_INVERSE = np.linalg.pinv(np.column_stack([np.ones(5), _AROUND, 0.5 * _AROUND**2]))


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """How much longer a scan is than what it shows; prior frame."""

    share: float
    direction: Array
    """(3,) unit vector of the sweep."""
    middle: Array
    """(3,) where the laser stood at mid-sweep: there nothing is displaced."""
    port_at_m: float
    """How far along the sweep from its middle the port was seen."""

    def corrected(self, rays: Rays) -> Rays:
        """Points and origins of a port as long as it is, in the place where it was seen."""
        along = (rays.origins - self.middle) @ self.direction - self.port_at_m
        return _shorter(rays, self.direction, along, self.share)

    def displaced(self) -> Array:
        """(3,) how much further along the sweep the port was seen than it is, as far as that is to be believed."""
        return np.asarray(BELIEVED * self.share * self.port_at_m * self.direction)


def _shorter(rays: Rays, direction: Array, along: Array, share: float) -> Rays:
    back = (share * along)[:, None] * direction
    return Rays(rays.points - back, rays.origins - back)


def fit_stretch(pose: Pose, rays: Rays, scene: Scene, model: PortModel, scale_m: float, threads: int = 1) -> Stretch:
    """The stretch of a scan whose port is at T_prior_port = ``pose``, weighed against what is usual."""
    along = (rays.origins - scene.sweep_middle) @ scene.sweep_direction
    port_at, share, curvature = float(np.median(along)), 0.0, 0.0
    for step in _STEPS:
        shorter = [_shorter(rays, scene.sweep_direction, along - port_at, share + step * k) for k in _AROUND]
        costs = [ray_costs(pose, tried, model, scale_m, threads).sum(dtype=np.float64) for tried in shorter]
        _, slope, curved = _PSEUDO_INVERSE @ costs
        curvature = max(curved / step**2, 0.0)
        best = (curvature * share - slope / step) / (curvature + SPEED**-2)
        share = float(np.clip(best, share - 2 * step, share + 2 * step))
    return Stretch(share, scene.sweep_direction, scene.sweep_middle, port_at)
