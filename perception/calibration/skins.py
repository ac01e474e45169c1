"""What sweeps of a target may meet: samples of its surface, before anything has been swept.

The poses of a calibration are planned with these (``foresight``). A skin is convex or seen through its mouth: what
faces the scanner is taken to be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.calibration.find_port import EDGE_M
from perception.calibration.find_sphere import GRAZING_RAD
from perception.calibration.targets import PlanesTarget, PortTarget, SphereTarget
from perception.geometry import Array, Pose
from perception.surface import Surface

SPHERE_SAMPLES = 800
FACE_M, FACE_STEP_M = 0.150, 0.005
"""A corner's faces are squares of at least this size; and how densely they are sampled."""
STEEPEST_ON_FACE = 0.2
"""A face has no edge in sight that a slanting ray could blur; beyond 78 deg little comes back."""
PORT_STEP_M = 0.0015
SEEN = 0.3
"""Port samples that a smaller share of directions sees are left out, and near edges, as the solver leaves those out."""
TIP_M = 0.02
"""A corner stands so far before the expected port's place."""


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Samples of a target in the base frame."""

    points: Array
    """(N, 3) metres."""
    normals: Array
    """(N, 3) unit, outwards."""
    own: Array
    """(N, K) change of the distance with the target's own parameters."""
    area_m2: Array
    """(N,) that each sample stands for."""
    part: NDArray[np.int64]
    """(N,) number of the part that each is on; a sweep is to meet all parts."""
    steepest: float = float(np.cos(GRAZING_RAD))
    """Cosine of the steepest incidence at which ranges are of use."""


def sphere_skin(target: SphereTarget) -> Skin:
    """All around, by the golden angle."""
    k = np.arange(SPHERE_SAMPLES) + 0.5
    z, angle = 1.0 - 2.0 * k / SPHERE_SAMPLES, k * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.sqrt(1.0 - z**2)
    outward = np.column_stack([flat * np.cos(angle), flat * np.sin(angle), z])
    points = target.centre + target.radius_m * outward
    area_m2 = np.full(SPHERE_SAMPLES, 4.0 * np.pi * target.radius_m**2 / SPHERE_SAMPLES)
    return Skin(points, outward, target.distances(points).own, area_m2, np.zeros(SPHERE_SAMPLES, np.int64))


def expected_corner(T_base_port: Pose) -> PlanesTarget:
    """The corner of a box where the port is expected, pointing at the robot; one face looks down, two to the sides."""
    up, side, along = np.sqrt(1.0 / 6.0), np.sqrt(1.0 / 2.0), np.sqrt(1.0 / 3.0)
    normals = T_base_port.rotate(np.array([[side, up, along], [-side, up, along], [0.0, -2.0 * up, along]]))
    tip = T_base_port.apply(np.array([[0.0, 0.0, TIP_M]]))[0]
    return PlanesTarget(normals, normals @ tip, np.zeros(0, dtype=np.int64))


def corner_skin(target: PlanesTarget, robot: Array) -> Skin:
    """Three squares that meet in the planes' common point.

    :param robot: (3,) a point on the side that the corner points to, base frame
    :raises numpy.linalg.LinAlgError: planes without a common point
    """
    tip = np.linalg.solve(target.normals, target.offsets)
    side = np.sign(target.normals @ (robot - tip))
    outward = target.normals * side[:, None]
    edges = np.cross(outward[[1, 2, 0]], outward[[2, 0, 1]])  # row k: along the edge between the two other faces
    edges *= -np.sign(np.einsum("ki,ki->k", edges, outward))[:, None]  # away from the tip, behind its own face's plane
    edges /= np.linalg.norm(edges, axis=1)[:, None]
    steps = np.arange(FACE_STEP_M / 2.0, FACE_M, FACE_STEP_M)
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(steps, steps))
    points = np.concatenate([tip + u * edges[(k + 1) % 3] + v * edges[(k + 2) % 3] for k in range(3)])
    plane = np.repeat(np.arange(3), len(u))
    own = PlanesTarget(outward, target.offsets * side, plane).distances(points).own
    skewed = [np.linalg.norm(np.cross(edges[(k + 1) % 3], edges[(k + 2) % 3])) for k in range(3)]
    return Skin(points, outward[plane], own, FACE_STEP_M**2 * np.array(skewed)[plane], plane, STEEPEST_ON_FACE)


def port_skin(T_base_port: Pose, surface: Surface) -> Skin:
    """What is seen of a port from before it, edges left out."""
    target = PortTarget.at(T_base_port, surface).with_free_depths(T_base_port.apply(surface.points))
    some = surface.thinned(PORT_STEP_M, PORT_STEP_M)
    chosen = (some.edge_m > EDGE_M) & (some.visibility > SEEN)
    points = T_base_port.apply(some.points[chosen])
    distances = target.distances(points)
    return Skin(points, distances.gradient, distances.own, some.area_m2[chosen], np.zeros(len(points), np.int64))
