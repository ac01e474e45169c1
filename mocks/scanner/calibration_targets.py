"""What may stand in the vehicle's place in the mock world while a scanner is calibrated: a sphere, a corner of a box.

Not simulated: a sphere that is out of round, paint that is thicker on one side, a stand that gives.
"""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from perception.evaluation.scene import KINDS, Patches, Scene, SceneSpec
from perception.port_shape import PortShape

ROUNDNESS = 512
"""Facets around the sphere: they lie within a micrometre of it."""
WALL_M = 0.12
"""Behind the target."""


def target_scene(kind: str, radius_m: float, shape: PortShape) -> Scene:
    """``sphere``: its centre in the frame's origin, on a rod. ``corner``: of a cube, pointing at the robot along z."""
    solid = _sphere(radius_m) if kind == "sphere" else _corner()
    wall = Manifold.cube((0.6, 0.6, 0.01), True).translate((0.0, 0.0, -WALL_M))
    parts = [solid, wall] if kind == "sphere" else [solid]
    meshes = [part.to_mesh() for part in parts]
    counts = np.cumsum([0, *(len(mesh.vert_properties) for mesh in meshes)])
    vertices = np.concatenate([np.asarray(mesh.vert_properties)[:, :3] for mesh in meshes]).astype(np.float64)
    faces = np.concatenate(
        [np.asarray(mesh.tri_verts).astype(np.int64) + start for mesh, start in zip(meshes, counts, strict=False)]
    )
    kinds = np.full(len(faces), KINDS.index("vehicle"))
    even = Patches(np.zeros((3, 1)), np.full(1, np.pi / 2))  # a target is painted matt: nothing drops out in patches
    return Scene(SceneSpec(shape, "plain"), vertices, faces, kinds, np.full(len(faces), -1), even, None, None)


def _sphere(radius_m: float) -> Manifold:
    ball = Manifold.sphere(radius_m, ROUNDNESS)
    rod = Manifold.cylinder(0.2, 0.006, 0.006, 48).rotate((90.0, 0.0, 0.0)).translate((0.0, -0.5 * radius_m, 0.0))
    return ball + rod


def _corner() -> Manifold:
    """A cube on its tip: its body diagonal along z, a corner at z = 20 mm."""
    cube = Manifold.cube((0.25, 0.25, 0.25)).translate((-0.25, -0.25, -0.25))  # the corner in the origin
    turned = cube.rotate((0.0, 0.0, 45.0)).rotate((float(np.rad2deg(np.arctan(np.sqrt(2.0)))), 0.0, 0.0))
    return turned.translate((0.0, 0.0, 0.02))
