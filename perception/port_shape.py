"""A vehicle inlet as numbers: outlines, depths, contacts; and the closed surface mesh that they describe.

Port frame: origin on the rim plane at the centre of the AC section, +z out of the vehicle, +y up, +x right for someone
who looks into the port. A *depth* is counted from the rim plane into the vehicle, so it is -z. Every outline is convex
(``outline``); what is not (a latch slot, a key) is a ``Key`` that is cut or added. Knows nothing
of the vehicle around the inlet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from perception.errors import MeshError
from perception.geometry import Array, Pose
from perception.outline import MM, Common, Disc, Hull, Outline, Point2, RoundedRect, outline_bounds, slabs, union

Ints = NDArray[np.int64]
_WALL_MM = 3.0  # thickness behind the deepest floor; never seen
_CLEAR_MM = 1.0  # by how much a cut stands proud of the surface that it opens


@dataclass(frozen=True, slots=True)
class Hole:
    """A bolt hole through the flange."""

    centre_m: Point2
    diameter_m: float


@dataclass(frozen=True, slots=True)
class Flange:
    """The mounting plate; its front lies ``front_depth_m`` behind the rim plane."""

    outline: Outline
    front_depth_m: float
    thickness_m: float = 0.004
    holes: tuple[Hole, ...] = ()


@dataclass(frozen=True, slots=True)
class Cavity:
    """The opening that the plug's shroud enters, down to the floor."""

    outline: Outline
    depth_m: float


@dataclass(frozen=True, slots=True)
class Insert:
    """A contact carrier that rises from the cavity's floor to ``face_depth_m`` below the rim plane."""

    outline: Outline
    face_depth_m: float


@dataclass(frozen=True, slots=True)
class Contact:
    """A pin standing in a well of its insert, or a socket: a bare bore."""

    name: str
    centre_m: Point2
    diameter_m: float
    tip_depth_m: float
    """Of a pin: where it ends. Of a socket: where the bore begins."""
    kind: Literal["pin", "socket"] = "pin"
    well_diameter_m: float | None = None
    """None: the pin stands free in the cavity."""
    floor_depth_m: float | None = None
    """Bottom of the well or bore; None: the cavity's floor."""
    tip_chamfer_m: float = 0.0005


@dataclass(frozen=True, slots=True)
class Key:
    """A feature that breaks the symmetry: a slot cut away or a ridge added, from one depth to another (m)."""

    name: str
    kind: Literal["slot", "ridge"]
    outline: Outline
    from_depth_m: float
    to_depth_m: float


@dataclass(frozen=True, slots=True)
class Finish:
    """What moulding adds to a drawing: taper of the walls and rounding of the edges."""

    draft_rad: float = 0.0
    edge_radius_m: float = 0.0


@dataclass(frozen=True, slots=True)
class PortShape:
    """One inlet. Lengths in metres, in the port frame."""

    name: str
    rim: Outline
    """Outer outline of the collar that ends in the rim plane."""
    cavity: Cavity
    flange: Flange | None = None
    inserts: tuple[Insert, ...] = ()
    contacts: tuple[Contact, ...] = ()
    keys: tuple[Key, ...] = ()
    finish: Finish = Finish()

    @property
    def back_depth_m(self) -> float:
        """Depth of the body's hidden back face."""
        floors = [c.floor_depth_m for c in self.contacts if c.floor_depth_m is not None]
        return max([self.cavity.depth_m, *floors]) + _WALL_MM / MM


@dataclass(frozen=True, slots=True)
class PortDescription:
    """An inlet, how its plug mates with it, and how far the numbers can be trusted."""

    name: str
    title: str
    shape: PortShape
    mated_depth_m: float
    """How far the plug's foremost face lies below the rim plane when it is fully mated."""
    capture_radius_m: float
    """Largest sideways offset that the lead-in chamfers take up."""
    capture_tilt_rad: float
    """Largest angle between the axes that they take up; the same holds for roll."""
    grade: Literal["A", "B", "P", "M"]
    """Of the numbers that decide the pose: A two CAD models agree, B one model, P published text, M from memory."""
    teach_before_docking: bool
    """True where the contacts are not known to a tenth of a millimetre."""
    fixed_parts: tuple[str, ...] = ("rim", "cavity", "insert", "well", "pin", "key")
    """Parts of ``PARTS`` that the standard fixes; the others vary between makes and must not decide the pose."""

    @property
    def T_port_tcp(self) -> Pose:
        """Pose of the mated plug: TCP z into the vehicle, TCP x along port x, origin on the plug's foremost face."""
        return Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -self.mated_depth_m]))


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
    mesh = solid.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3] / MM
    faces = np.asarray(mesh.tri_verts, dtype=np.int64)
    lengths = np.diff(np.asarray(mesh.run_index)) // 3
    part = np.repeat([maker.part_of.get(int(k), 0) for k in mesh.run_original_id], lengths)
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


__all__ = [
    "PARTS",
    "Cavity",
    "Common",
    "Contact",
    "Disc",
    "Finish",
    "Flange",
    "Hole",
    "Hull",
    "Insert",
    "Ints",
    "Key",
    "Outline",
    "Point2",
    "PortDescription",
    "PortMesh",
    "PortShape",
    "RoundedRect",
    "build_mesh",
    "build_parts",
    "loose_heights_m",
    "outline_bounds",
]
