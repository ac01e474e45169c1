"""A scene to scan, ready to be ray-cast: an inlet as built in its vehicle, or a thing that only looks like one.

The scene's frame is the port frame. Where there is no port it is the frame in which the port would have been.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import open3d as o3d
from manifold3d import Manifold

from perception.evaluation import vehicle
from perception.evaluation.built import TYPICAL, BuiltTolerance
from perception.evaluation.families import built_part
from perception.evaluation.vehicle import Occluder, Pocket, Rng, Side
from perception.geometry import Array
from perception.outline import Outline, Point2, outline_bounds
from perception.port_shape import PortShape
from perception.port_solid import PARTS, Ints, PortMesh

Negative = Literal[
    "plain", "empty-pocket", "closed-cover", "dust-cap", "plug-inserted", "other-recess", "mirrored", "no-contacts"
]
NEGATIVES: tuple[Negative, ...] = (
    "plain",
    "empty-pocket",
    "closed-cover",
    "dust-cap",
    "plug-inserted",
    "other-recess",
    "mirrored",
    "no-contacts",
)
PORTLESS: tuple[Negative, ...] = ("plain", "empty-pocket", "closed-cover", "other-recess")
"""Negatives without any inlet; the others show one that must not be docked with."""

KINDS = ("port", "vehicle", "cover", "occluder", "clutter", "cap", "plug")
"""What a face belongs to, in the order of ``Scene.kind``."""

_MM = 1000.0
_WAVES = 10
_PATCH_WAVE = 280.0  # rad/m: patches of about 10 mm


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """What a scene shows. What it looks like in detail is drawn from the generator given to ``build_scene``."""

    shape: PortShape
    negative: Negative | None = None
    cover: Side | None = None
    """Side of the pocket on which an open cover is hinged; None: no cover in sight."""
    occluders: tuple[Occluder, ...] = ()
    clutter: int = 0
    tolerance: BuiltTolerance = TYPICAL
    panel_height_m: tuple[float, float] = (0.012, 0.042)
    """Range of the panel's height over the rim plane."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Where a surface returns little light: a smooth random field over the scene, above a threshold."""

    waves: Array
    """(3, K) wave vectors in rad/m."""
    phases: Array
    """(K,)"""

    def level(self, points: Array) -> Array:
        """The field at points (N, 3): about normally distributed with unit variance."""
        angle = points.astype(np.float32) @ self.waves.astype(np.float32) + self.phases.astype(np.float32)
        field: Array = np.cos(angle).sum(axis=1, dtype=np.float64) * np.sqrt(2.0 / len(self.phases))
        return field


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles, what each of them belongs to, and the structure that rays are cast against."""

    spec: SceneSpec
    vertices: Array
    """(V, 3) metres, port frame."""
    faces: Ints
    """(F, 3)"""
    kind: Ints
    """(F,) index into ``KINDS``."""
    part: Ints
    """(F,) index into ``PARTS`` for faces of the inlet, -1 elsewhere."""
    patches: Patches
    built: PortMesh | None
    """The inlet as built; None where there is none."""
    cover_corners: Array | None
    """(8, 3) corners of the box around the open cover, metres."""

    @cached_property
    def caster(self) -> Any:
        """Open3D's ray-casting scene (Embree)."""
        caster = o3d.t.geometry.RaycastingScene()
        caster.add_triangles(
            o3d.core.Tensor.from_numpy(self.vertices.astype(np.float32)),
            o3d.core.Tensor.from_numpy(self.faces.astype(np.uint32)),
        )
        return caster

    def without(self, kind: str) -> Scene:
        """The same scene with all faces of one kind taken away."""
        keep = self.kind != KINDS.index(kind)
        return replace(self, faces=self.faces[keep], kind=self.kind[keep], part=self.part[keep])


def negatives_for(shape: PortShape) -> tuple[Negative, ...]:
    """The negatives that make sense for ``shape``: a port that is its own mirror image has no mirrored one."""
    own_mirror = is_mirror_symmetric(shape)
    return tuple(kind for kind in NEGATIVES if not (kind == "mirrored" and own_mirror))


def is_mirror_symmetric(shape: PortShape) -> bool:
    """Whether left and right of the inlet are the same as far as contacts and keys go (to 0.1 mm)."""

    def places(sign: float) -> set[tuple[int, ...]]:
        contacts = [(c.centre_m, c.diameter_m, c.well_diameter_m or 0.0, c.tip_depth_m) for c in shape.contacts]
        keys = [(_centre(key.outline), key.from_depth_m, key.to_depth_m, 0.0) for key in shape.keys]
        numbers = [(sign * centre[0], centre[1], *rest) for centre, *rest in (*contacts, *keys)]
        return {tuple(round(value * 1e4) for value in row) for row in numbers}

    return places(1.0) == places(-1.0)


def _centre(outline: Outline) -> Point2:
    low_x, low_y, high_x, high_y = outline_bounds(outline)
    return (low_x + high_x) / 2, (low_y + high_y) / 2


def build_scene(spec: SceneSpec, rng: Rng) -> Scene:
    """One vehicle that answers to ``spec``; the same generator state gives the same vehicle.

    :raises ValueError: a mirrored scene of a port that is its own mirror image: it would be no negative.
    """
    if spec.negative == "mirrored" and is_mirror_symmetric(spec.shape):
        raise ValueError(f"port {spec.shape.name!r} is its own mirror image")
    pocket = vehicle.draw_pocket(spec.shape, spec.panel_height_m, rng)
    built = None if spec.negative in PORTLESS else _built_port(spec, rng)
    solids = [*_vehicle(spec, pocket, rng), *_in_the_way(spec, pocket, rng)]
    cover = None
    if spec.cover is not None and spec.negative not in ("plain", "closed-cover"):
        cover = vehicle.open_cover(pocket, spec.cover, float(rng.uniform(1.6, 2.9)), rng)
        solids.append(("cover", cover))
    vertices, faces, kind, part = _assemble(built, solids)
    patches = Patches(rng.normal(0.0, _PATCH_WAVE, (3, _WAVES)), rng.uniform(0.0, 2 * np.pi, _WAVES))
    return Scene(spec, vertices, faces, kind, part, patches, built, None if cover is None else _corners(cover))


def _built_port(spec: SceneSpec, rng: Rng) -> PortMesh:
    """The inlet as built; mirrored or without contacts where the scene wants that."""
    mesh = built_part(spec.shape, spec.tolerance, rng, contacts=spec.negative != "no-contacts")
    if spec.negative == "mirrored":
        return PortMesh(mesh.vertices * np.array([-1.0, 1.0, 1.0]), mesh.faces[:, ::-1].copy(), mesh.part)
    return mesh


def _vehicle(spec: SceneSpec, pocket: Pocket, rng: Rng) -> list[tuple[str, Manifold]]:
    """The panel with its opening, and what sits in or on the inlet."""
    skin = vehicle.panel(pocket)
    if spec.negative == "plain":
        return [("vehicle", skin)]
    if spec.negative == "closed-cover":
        return [("vehicle", skin - vehicle.closed_cover_gap(pocket))]
    skin -= vehicle.recess(pocket)
    if spec.negative == "empty-pocket":
        return [("vehicle", skin)]
    if spec.negative == "other-recess":
        cut, added = vehicle.other_recess(pocket, rng)
        return [("vehicle", skin - cut), ("vehicle", added)]
    solids = [("vehicle", skin - vehicle.body_hole(spec.shape))]
    if spec.negative == "dust-cap":
        solids.append(("cap", vehicle.dust_cap(spec.shape, rng)))
    if spec.negative == "plug-inserted":
        solids.append(("plug", vehicle.inserted_plug(spec.shape, rng)))
    return solids


def _in_the_way(spec: SceneSpec, pocket: Pocket, rng: Rng) -> list[tuple[str, Manifold]]:
    """Occluders and clutter."""
    low_x, low_y, high_x, high_y = outline_bounds(spec.shape.rim)
    reach = max(high_x - low_x, high_y - low_y) / 2 * _MM
    blocking = [("occluder", vehicle.occluder(kind, reach, rng)) for kind in spec.occluders]
    return blocking + [("clutter", vehicle.clutter(pocket, rng)) for _ in range(spec.clutter)]


def _assemble(built: PortMesh | None, solids: list[tuple[str, Manifold]]) -> tuple[Array, Ints, Ints, Ints]:
    """All meshes as one: vertices (m), faces, and the kind and inlet part of each face."""
    vertices, faces, kinds, parts = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [], []
    if built is not None:
        vertices, faces = [built.vertices], [built.faces]
        kinds.append(np.full(len(built.faces), KINDS.index("port")))
        parts.append(built.part)
    count = len(vertices[0])
    for kind, solid in solids:
        mesh = solid.to_mesh64()
        points = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3] / _MM
        triangles = np.asarray(mesh.tri_verts, dtype=np.int64)
        vertices.append(points)
        faces.append(triangles + count)
        kinds.append(np.full(len(triangles), KINDS.index(kind)))
        parts.append(np.full(len(triangles), -1))
        count += len(points)
    return np.vstack(vertices), np.vstack(faces), np.concatenate(kinds), np.concatenate(parts)


def _corners(solid: Manifold) -> Array:
    """Corners (8, 3) in metres of the box around a solid."""
    low_x, low_y, low_z, high_x, high_y, high_z = solid.bounding_box()
    grid = np.meshgrid([low_x, high_x], [low_y, high_y], [low_z, high_z], indexing="ij")
    return np.stack(grid, axis=-1).reshape(8, 3) / _MM


__all__ = [
    "KINDS",
    "NEGATIVES",
    "PARTS",
    "PORTLESS",
    "Negative",
    "Patches",
    "Scene",
    "SceneSpec",
    "build_scene",
    "negatives_for",
]
