"""An inlet that no constant of the locator was chosen on, modelled by code of its own: three lobes, domed contacts.

The bundled ports, and the parts that are scanned of them, all come from ``port_solid``: what that cannot draw, no scan
of them shows. Here walls lean in, the carrier's face is a dome, contacts end in half balls and lean, the key is a
wedge, the flange is bowed and its bolts sit in counterbores; the part shrinks along each axis by itself. It is not its
own mirror image. Lengths in millimetres, depths downwards from the rim plane, in the port frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from perception.evaluation.built import BuiltTolerance
from perception.geometry import Array
from perception.outline import Disc, Hull, RoundedRect
from perception.port_shape import Cavity, Contact, Flange, Insert, PortShape
from perception.port_solid import PARTS, PortMesh

NAME = "trilobe"
LOBES = ((0.0, 15.0, 11.0), (-14.0, -9.0, 12.0), (14.0, -9.0, 12.0))
"""x, y, radius of the discs around which the collar lies."""
WALL, LEAD_IN, FLOOR, BACK = 2.6, 1.3, 26.0, 30.0
FACE, FACE_RADIUS, DOME_RADIUS, WELL_FLOOR = 8.0, 13.0, 110.0, 23.0
FLANGE_RADIUS, FLANGE_FRONT, FLANGE_THICK = 41.0, 9.0, 4.0
BOLTS = tuple((35.0 * np.cos(a), 35.0 * np.sin(a)) for a in np.deg2rad([90.0, 210.0, 330.0]))
KEY = ((-9.5, 9.0), (-6.0, 5.0), (-12.0, 4.0))
"""The wedge at the wall, seen from the front; it begins at a third of the depth."""
ROUND = 96


@dataclass(frozen=True, slots=True)
class Pin:
    """One contact: where it stands, how thick it is and where it ends."""

    x: float
    y: float
    radius: float
    tip: float


PINS = (
    Pin(-6.3, 3.6, 2.5, 10.5), Pin(6.3, 3.6, 2.5, 10.5), Pin(0.0, -4.6, 2.0, 10.5), Pin(3.4, 9.0, 1.2, 12.0),
    Pin(-8.0, -5.2, 1.2, 12.0),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Part:
    """How one part differs from the drawing."""

    pins: tuple[Pin, ...] = PINS
    leans: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * len(PINS)
    """Degrees about x and y."""
    face: float = FACE
    floor: float = FLOOR
    lead_in: float = LEAD_IN
    wall_lean: float = 0.02
    bow: float = 0.0
    """How far the flange's edge stands forward."""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


def drawing() -> PortMesh:
    """The inlet as its CAD has it."""
    return _mesh(_Part())


def built(tolerance: BuiltTolerance, rng: np.random.Generator, *, contacts: bool = True) -> PortMesh:
    """One part as built; without any contact if that is asked for."""
    t, off = tolerance, rng.normal(0.0, 1.0, (len(PINS), 3))
    mm = np.array([t.pin_lateral_m, t.pin_lateral_m, t.pin_axial_m]) * 1e3
    pins = tuple(Pin(p.x + dx, p.y + dy, p.radius, p.tip + dz) for p, (dx, dy, dz) in zip(PINS, off * mm, strict=True))
    leans = tuple((float(a), float(b)) for a, b in rng.normal(0.0, 0.25, (len(PINS), 2)))
    x, y, z = 1.0 + rng.normal(0.0, t.shrink, 3)
    part = _Part(
        pins if contacts else (),
        leans if contacts else (),
        FACE + float(rng.normal(0.0, t.face_m)) * 1e3,
        FLOOR + float(rng.normal(0.0, t.floor_m)) * 1e3,
        LEAD_IN + float(rng.uniform(-0.1, 0.1)),
        0.02 + float(rng.normal(0.0, t.draft_rad)),
        float(rng.uniform(-0.3, 0.3)),
        (float(x), float(y), float(z)),
    )
    return _mesh(part)


def _mesh(part: _Part) -> PortMesh:
    names: dict[int, str] = {}

    def named(name: str, solid: Manifold) -> Manifold:
        one = solid.as_original()
        names[one.original_id()] = name
        return one

    solid = named("rim", _prism(_collar(0.0), 0.0, BACK)) + named("flange", _flange())
    lean = part.wall_lean * part.floor
    solid -= named("cavity", _between(_collar(-WALL + part.lead_in), _collar(-WALL), -0.001, part.lead_in))
    solid -= named("cavity", _between(_collar(-WALL), _collar(-WALL - lean), part.lead_in - 0.01, part.floor))
    solid += named("insert", _carrier(part))
    for pin in PINS:  # wells are there even where contacts are missing
        well = _between(_disc(pin, pin.radius + 1.0), _disc(pin, pin.radius + 0.7), 0.0, WELL_FLOOR)
        solid -= named("well", well)
    for pin, lean_deg in zip(part.pins, part.leans, strict=True):
        solid += named("pin", _pin(pin, lean_deg))
    solid += named("key", _prism(CrossSection.hull_points(np.array(KEY)), part.floor / 3.0, part.floor + 1.0))
    mesh = solid.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3]
    lengths = np.diff(np.asarray(mesh.run_index)) // 3
    kinds = np.repeat([PARTS.index(names[int(k)]) for k in mesh.run_original_id], lengths)
    faces = np.asarray(mesh.tri_verts, dtype=np.int64)
    return PortMesh(_as_built(vertices, part) / 1e3, faces, _with_floors(vertices, faces, kinds))


def _as_built(vertices: Array, part: _Part) -> Array:
    """Bowed flange, and shrinkage along each axis."""
    beyond = np.clip((np.hypot(vertices[:, 0], vertices[:, 1]) - 29.0) / 12.0, 0.0, None)
    return np.asarray((vertices + np.array([0.0, 0.0, 1.0]) * (part.bow * beyond**2)[:, None]) * part.scale)


def _with_floors(vertices: Array, faces: NDArray[np.int64], kinds: NDArray[np.int64]) -> NDArray[np.int64]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    up = normal[:, 2] > 0.9 * np.linalg.norm(normal, axis=1)
    sunk = (kinds == PARTS.index("cavity")) | (kinds == PARTS.index("well"))
    return np.where(up & sunk, PARTS.index("floor"), kinds)


def _collar(grow: float) -> CrossSection:
    return CrossSection.batch_hull([CrossSection.circle(r + grow, ROUND).translate((x, y)) for x, y, r in LOBES])


def _disc(pin: Pin, radius: float) -> CrossSection:
    return CrossSection.circle(radius, ROUND // 2).translate((pin.x, pin.y))


def _prism(section: CrossSection, top: float, bottom: float) -> Manifold:
    return section.extrude(bottom - top).translate((0.0, 0.0, -bottom))


def _between(upper: CrossSection, lower: CrossSection, top: float, bottom: float) -> Manifold:
    """The hull of two sections at two depths."""
    return Manifold.batch_hull([_prism(upper, top, top + 0.001), _prism(lower, bottom - 0.001, bottom)])


def _flange() -> Manifold:
    plate = _prism(CrossSection.circle(FLANGE_RADIUS, 6), FLANGE_FRONT, FLANGE_FRONT + FLANGE_THICK)
    plate = plate.refine_to_length(4.0)  # so that it can be bowed
    for x, y in BOLTS:
        plate -= _prism(CrossSection.circle(2.7, ROUND // 2).translate((x, y)), 0.0, BACK)
        plate -= _prism(CrossSection.circle(4.8, ROUND // 2).translate((x, y)), 0.0, FLANGE_FRONT + 1.4)
    return plate


def _carrier(part: _Part) -> Manifold:
    column = _prism(CrossSection.circle(FACE_RADIUS, ROUND).scale((1.1, 1.0)), part.face - 2.0, part.floor + 1.0)
    ball = Manifold.sphere(DOME_RADIUS, 4 * ROUND).translate((0.0, 0.0, -part.face - DOME_RADIUS))
    return column ^ ball


def _pin(pin: Pin, lean_deg: tuple[float, float]) -> Manifold:
    length = WELL_FLOOR + 1.0 - pin.tip
    ball = Manifold.sphere(pin.radius, ROUND // 2).translate((0.0, 0.0, length - pin.radius))
    upright = Manifold.cylinder(length - pin.radius, pin.radius, pin.radius, ROUND // 2) + ball
    return upright.rotate((*lean_deg, 0.0)).translate((pin.x, pin.y, -WELL_FLOOR - 1.0))


def _shape() -> PortShape:
    rim = Hull(tuple(Disc(2e-3 * r, (1e-3 * x, 1e-3 * y)) for x, y, r in LOBES))
    opening = Hull(tuple(Disc(2e-3 * (r - WALL), (1e-3 * x, 1e-3 * y)) for x, y, r in LOBES))
    side = 2e-3 * FLANGE_RADIUS
    contacts = tuple(
        Contact(f"contact {k}", (1e-3 * p.x, 1e-3 * p.y), 2e-3 * p.radius, 1e-3 * p.tip) for k, p in enumerate(PINS)
    )
    return PortShape(
        NAME,
        rim,
        Cavity(opening, 1e-3 * FLOOR),
        Flange(RoundedRect(side, side, 0.005), 1e-3 * FLANGE_FRONT, 1e-3 * FLANGE_THICK),
        (Insert(Disc(2e-3 * FACE_RADIUS), 1e-3 * FACE),),
        contacts,
    )


SHAPE = _shape()
"""Its main dimensions in the terms of the other ports: what the vehicle, a cap or a plug around it needs to know."""
