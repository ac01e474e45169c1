"""The closed surface mesh of an inlet that is described as numbers (``port_shape``), face by face with its part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from perception.errors import MeshError
from perception.geometry import Array
from perception.outline import MM, Disc, Outline, outline_bounds, slabs, union
from perception.port_shape import Contact, Finish, Flange, Key, PortDescription, PortShape

Ints = NDArray[np.int64]
_CLEAR_MM = 1.0  # by how much a cut stands proud of the surface that it opens

PARTS = ("flange", "rim", "cavity", "floor", "insert", "well", "pin", "key")
"""Names of the surface parts, in the order of ``PortMesh.part``."""


@dataclass(frozen=True, slots=True, eq=False)
class PortMesh:
    """A closed triangle mesh whose faces know the part of the inlet they belong to."""

    vertices: Array
    """(V, 3) in metres, port frame."""
    faces: Ints
    """(F, 3) vertex numbers, counter-clockwise seen from outside."""
    part: Ints
    """(F,) index into ``PARTS``."""


def build_mesh(shape: PortShape) -> tuple[Array, Ints]:
    """The inlet's surface: vertices (V, 3) in metres and faces (F, 3). Raises MeshError as ``build_parts`` does."""
    mesh = build_parts(shape)
    return mesh.vertices, mesh.faces


def build_parts(shape: PortShape) -> PortMesh:
    """The inlet's surface with the part of each face. Raises MeshError where the numbers enclose no solid."""
    maker = _Maker(shape.finish)
    solid = maker.body(shape)
    if solid.is_empty():
        raise MeshError(f"the dimensions of port {shape.name!r} enclose no solid", remedy="Check its description.")
    return labelled_mesh(solid, maker.part_of)


def labelled_mesh(solid: Manifold, part_of: Mapping[int, int]) -> PortMesh:
    """A solid in millimetres as a mesh. ``part_of``: index into ``PARTS`` by the original id of what it was made of."""
    mesh = solid.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3] / MM
    faces = np.asarray(mesh.tri_verts, dtype=np.int64)
    lengths = np.diff(np.asarray(mesh.run_index)) // 3
    part = np.repeat([part_of.get(int(k), 0) for k in mesh.run_original_id], lengths)
    return PortMesh(vertices, faces, _name_floors(vertices, faces, part))


def loose_heights_m(port: PortDescription) -> tuple[float, ...]:
    """Heights of the flats of parts that the standard leaves to the makers, metres over the rim plane."""
    mesh = build_parts(port.shape)
    corners = mesh.vertices[mesh.faces]
    flat = np.ptp(corners[:, :, 2], axis=1) < 1e-9
    fixed = np.isin(mesh.part, [PARTS.index(name) for name in port.fixed_parts])
    at = {loose: np.unique(np.round(corners[flat & (fixed != loose), 0, 2], 6)) for loose in (True, False)}
    return tuple(float(height) for height in np.setdiff1d(at[True], at[False]))


def _name_floors(vertices: Array, faces: Ints, part: Ints) -> Ints:
    """Cavity and well faces that look out of the vehicle are floor."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    looks_out = normal[:, 2] > 0.9 * np.linalg.norm(normal, axis=1)
    inside = np.isin(part, [PARTS.index("cavity"), PARTS.index("well")])
    return np.where(inside & looks_out, PARTS.index("floor"), part)


class _Maker:
    """Builds the solids of one shape and remembers which part each of them is (by the modeller's ids)."""

    def __init__(self, finish: Finish) -> None:
        self.part_of: dict[int, int] = {}
        self.edge = finish.edge_radius_m * MM
        self.taper = float(np.tan(finish.draft_rad))

    def body(self, shape: PortShape) -> Manifold:
        """Flange and collar, minus cavity, plus inserts with their wells, plus pins and keys."""
        floor, back = shape.cavity.depth_m * MM, shape.back_depth_m * MM
        solid = self.raised("rim", shape.rim, 0.0, back, taper=False)
        if shape.flange is not None:
            solid += self.flange(shape.flange)
        solid -= self.sunk("cavity", shape.cavity.outline, 0.0, floor)
        for insert in shape.inserts:
            solid += self.raised("insert", insert.outline, insert.face_depth_m * MM, floor + _CLEAR_MM)
        cuts = [self.key(key) for key in shape.keys if key.kind == "slot"]
        cuts += [well for contact in shape.contacts for well in self.well(shape, contact)]
        adds = [self.key(key) for key in shape.keys if key.kind == "ridge"]
        adds += [self.pin(shape, contact) for contact in shape.contacts if contact.kind == "pin"]
        return solid - union(cuts) + union(adds)

    def flange(self, flange: Flange) -> Manifold:
        """The plate with its bolt holes."""
        front, back = flange.front_depth_m * MM, (flange.front_depth_m + flange.thickness_m) * MM
        plate = self.raised("flange", flange.outline, front, back, taper=False)
        for hole in flange.holes:
            cut = [(front - _CLEAR_MM, 0.0), (back + _CLEAR_MM, 0.0)]
            plate -= self.prism("flange", Disc(hole.diameter_m, hole.centre_m), cut)
        return plate

    def key(self, key: Key) -> Manifold:
        """A slot or ridge."""
        return self.prism("key", key.outline, [(key.from_depth_m * MM, 0.0), (key.to_depth_m * MM, 0.0)])

    def well(self, shape: PortShape, contact: Contact) -> list[Manifold]:
        """What is cut for a contact: a socket's bore or a pin's well, if it has one."""
        floor = (contact.floor_depth_m or shape.cavity.depth_m) * MM
        if contact.kind == "socket":
            return [self.sunk("well", Disc(contact.diameter_m, contact.centre_m), contact.tip_depth_m * MM, floor)]
        if contact.well_diameter_m is None or not shape.inserts:
            return []
        face = _face_depth(shape, contact) * MM
        return [self.sunk("well", Disc(contact.well_diameter_m, contact.centre_m), face, floor)]

    def pin(self, shape: PortShape, contact: Contact) -> Manifold:
        """A pin from its chamfered tip to below the floor of its well."""
        floor = (contact.floor_depth_m or shape.cavity.depth_m) * MM
        tip, chamfer = contact.tip_depth_m * MM, contact.tip_chamfer_m * MM
        stations = [(tip, -chamfer), (tip + chamfer, 0.0), (floor + _CLEAR_MM, 0.0)]
        return self.prism("pin", Disc(contact.diameter_m, contact.centre_m), stations)

    def raised(self, part: str, outline: Outline, top: float, bottom: float, *, taper: bool = True) -> Manifold:
        """A solid that rises to depth ``top``: rounded edge there, wider towards its root. Depths in mm."""
        slope = self.taper if taper else 0.0
        edge = [(top + d, -g) for d, g in self.rounding()]
        return self.prism(part, outline, [*edge, (bottom, slope * (bottom - top))])

    def sunk(self, part: str, outline: Outline, top: float, bottom: float) -> Manifold:
        """A cut that opens at depth ``top``: rounded mouth there, narrower towards its floor. Depths in mm."""
        edge = [(top + d, g) for d, g in self.rounding()]
        above = (top - _CLEAR_MM, edge[0][1])
        return self.prism(part, outline, [above, *edge, (bottom, -self.taper * (bottom - top))])

    def rounding(self) -> list[tuple[float, float]]:
        """(further depth, offset) along a rounded edge, from the face to the wall."""
        if self.edge < 1e-6:
            return [(0.0, 0.0)]
        turn = np.linspace(0.0, np.pi / 2, 4)
        return [(self.edge * (1 - np.cos(a)), self.edge * (1 - np.sin(a))) for a in turn]

    def prism(self, part: str, outline: Outline, stations: Sequence[tuple[float, float]]) -> Manifold:
        """The solid through ``outline`` grown by each station's offset at its depth: (depth, offset) in mm."""
        pieces = slabs(outline, stations)
        for piece in pieces:
            self.part_of[piece.original_id()] = PARTS.index(part)
        return union(pieces)


def _face_depth(shape: PortShape, contact: Contact) -> float:
    """Face depth of the insert whose outline holds the contact; the nearest to the rim if none does."""
    for insert in shape.inserts:
        low_x, low_y, high_x, high_y = outline_bounds(insert.outline)
        x, y = contact.centre_m
        if low_x <= x <= high_x and low_y <= y <= high_y:
            return insert.face_depth_m
    return min(insert.face_depth_m for insert in shape.inserts)
