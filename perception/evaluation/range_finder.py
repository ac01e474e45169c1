"""A range finder whose beam turns in the plane y = 0 of its frame, ray-cast: true ranges, and what was hit."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from perception.evaluation.scene import Scene
from perception.geometry import Array, Pose
from perception.port_solid import Ints

BEAM_RAD = 0.004
"""1 sigma of where in its beam a ray is taken: ranges are of a patch, so edges are not sharp."""


def ranges_from(scene: Scene, T_port_scanner: Pose, angles_rad: Array, rng: np.random.Generator) -> tuple[Array, Ints]:
    """Distance (N,) of what each beam meets first, inf without any, and its kind (N,), arbitrary there.

    :param angles_rad: (N,) to the right of z, about -y of the scanner frame.
    """
    across, along = rng.normal(0.0, BEAM_RAD, (2, len(angles_rad)))
    turned = angles_rad + across
    rays = np.stack([np.sin(turned), along, np.cos(turned)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    origins = np.broadcast_to(T_port_scanner.translation, rays.shape)
    tensor = o3d.core.Tensor.from_numpy(np.hstack([origins, rays @ T_port_scanner.rotation.T]).astype(np.float32))
    answer = scene.caster.cast_rays(tensor, nthreads=1)
    distance = answer["t_hit"].numpy().astype(np.float64)
    face = np.where(np.isfinite(distance), answer["primitive_ids"].numpy().astype(np.int64), 0)
    return distance, scene.kind[face]
