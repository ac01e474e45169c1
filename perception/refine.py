"""Final pose: the rays say where the port is across its axis and how it is rolled, its surfaces how high and tilted.

Each of the two takes the other's part as it is, and both are asked twice: coarsely and finely.
"""

from __future__ import annotations

from dataclasses import dataclass

from perception.approach import approach
from perception.crop import Scene
from perception.depths import depth_dispute
from perception.distortion import Distortion, distortion
from perception.errors import DegenerateCloudError
from perception.geometry import Array, Pose
from perception.matching import Measured, measure
from perception.port_model import PortModel
from perception.rays import COARSE_M, FINE_LEAST_M, FINE_SIGMAS, FINEST_M, ROUGHLY, RayFit, Rays, fit_rays, telling
from perception.stretch import Stretch, fit_stretch
from perception.upright import Upright, set_upright

_POINTS = 20_000
"""So many are enough."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The final pose, what gave it, and what about it is odd."""

    T_prior_port: Pose
    upright: Upright
    """What the surfaces say."""
    rays: RayFit
    """How surely the rays say it, over a distance at which no single ray decides."""
    stretch: Stretch
    """By how much the scan is longer along the sweep than the port."""
    sweep: Array
    """(3,) unit vector of the scanner's sweep, port frame."""
    distortion: Distortion
    """Of the scan around this pose."""
    depth_dispute_m: float
    """How much higher than the model has it the flat that disagrees most is seen."""

    @property
    def scale_m(self) -> float:
        """Robust standard deviation of the distances to surfaces."""
        return self.upright.scale_m

    @property
    def rms_m(self) -> float:
        """Weighted root mean square distance to the surface."""
        return self.upright.rms_m


def refine(start: Pose, scene: Scene, model: PortModel, *, threads: int = 2) -> Refined:
    """Refines ``start`` (T_prior_port). Raises DegenerateCloudError when the points near it do not fix a pose."""
    near = model.nearest.lookup(start.inverse().apply(scene.points)) < model.nearest.none
    if int(near.sum()) < 50:
        raise DegenerateCloudError("hardly any scan point lies near the port's surface")
    measured = measure(scene.points[near], scene.origins[near], threads).at_most(_POINTS)
    pose, scale = approach(start, measured, model, threads)

    rays = telling(pose, Rays(measured.points, measured.origins), model, scale, COARSE_M[0], threads)
    coarse = fit_rays(pose, rays.at_most(ROUGHLY), model, scale, COARSE_M, threads)
    upright = set_upright(coarse.T_prior_port, measured, scene, model, scale, 2, threads)

    seen = fit_rays(upright.T_prior_port, rays, model, upright.scale_m, _fine_m(upright.scale_m), threads)
    stretch = fit_stretch(seen.T_prior_port, rays, scene, model, upright.scale_m, threads)
    best = fit_rays(seen.T_prior_port, stretch.corrected(rays), model, upright.scale_m, FINEST_M, threads)
    upright = set_upright(best.T_prior_port, _corrected(measured, stretch), scene, model, upright.scale_m, 1, threads)

    pose = upright.T_prior_port
    return Refined(
        Pose(pose.rotation, pose.translation - stretch.displaced()),
        upright,
        max(seen, coarse, key=lambda fit: fit.least_known),
        stretch,
        pose.inverse().rotate(scene.sweep_direction),
        distortion(pose, measured, model, upright.scale_m),
        depth_dispute(pose, measured, model.flats, upright.scale_m),
    )


def _fine_m(scale_m: float) -> tuple[float, float]:
    """A noisy scan tells nothing over distances far below its noise."""
    least = max(FINE_SIGMAS * scale_m, FINE_LEAST_M)
    return 2 * least, least


def _corrected(measured: Measured, stretch: Stretch) -> Measured:
    rays = stretch.corrected(Rays(measured.points, measured.origins))
    return Measured(rays.points, measured.normals, rays.origins)
