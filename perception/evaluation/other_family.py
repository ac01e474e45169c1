"""An inlet that no constant of the locator was chosen on, modelled by code of its own: three lobes, domed contacts.

The bundled ports, and the parts that are scanned of them, all come from ``port_solid``: what that cannot draw, no scan
of them shows. Here walls lean in, the carrier's face is a dome, contacts end in half balls and lean, the key is a
wedge, the flange is bowed and its bolts sit in counterbores; the part shrinks along each axis by itself. It is not its
own mirror image. Lengths in millimetres, depths downwards from the rim plane, in the port frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from manifold3d import CrossSection, Manifold

from perception.evaluation.built import TYPICAL, BuiltTolerance
from perception.geometry import Array
from perception.outline import Disc, Hull, RoundedRect
from perception.port_shape import Cavity, Contact, Flange, Insert, PortShape
from perception.port_solid import PARTS, PortMesh, labelled_mesh

NAME = "trilobe"
LOBES_MM = ((0.0, 15.0, 11.0), (-14.0, -9.0, 12.0), (14.0, -9.0, 12.0))
"""x, y, radius of the discs around which the collar lies."""
WALL_MM, LEAD_IN_MM, FLOOR_MM, BACK_MM = 2.6, 1.3, 26.0, 30.0
FACE_MM, FACE_RADIUS_MM, DOME_RADIUS_MM, WELL_FLOOR_MM = 8.0, 13.0, 110.0, 23.0
FLANGE_RADIUS_MM, FLANGE_FRONT_MM, FLANGE_THICK_MM = 41.0, 9.0, 4.0
BOLTS_MM = tuple((35.0 * np.cos(a), 35.0 * np.sin(a)) for a in np.deg2rad([60.0, 180.0, 300.0]))
KEY_MM = ((-18.0, 3.5), (-14.0, 10.5), (-13.2, 6.0))
"""Corners of the wedge at the left wall, seen from the front; it begins at a third of the depth."""
ROUND = 96


@dataclass(frozen=True, slots=True)
class Pin:
    """One contact: where it stands, how thick it is and where it ends."""

    x_mm: float
    y_mm: float
    radius_mm: float
    tip_mm: float
    """Depth at which it ends."""


PINS = (
    Pin(-6.3, 3.6, 2.5, 10.5), Pin(6.3, 3.6, 2.5, 10.5), Pin(0.0, -4.6, 2.0, 10.5), Pin(3.4, 9.0, 1.2, 12.0),
    Pin(-8.0, -5.2, 1.2, 12.0),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Part:
    """How one part differs from the drawing."""

    pins: tuple[Pin, ...] = PINS
    leans_deg: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * len(PINS)
    """Of the contacts, about x and y."""
    face_mm: float = FACE_MM
    floor_mm: float = FLOOR_MM
    lead_in_mm: float = LEAD_IN_MM
    wall_lean_rad: float = 0.02
    bow_mm: float = 0.0
    """How far the flange's edge stands forward."""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


def drawing() -> PortMesh:
    """The inlet as its CAD has it."""
    return _mesh(_Part())


def built(tolerance: BuiltTolerance, rng: np.random.Generator, *, contacts: bool = True) -> PortMesh:
    """One part as built; without any contact if that is asked for."""
    t, off = tolerance, rng.normal(0.0, 1.0, (len(PINS), 3))
    rough = t.edge_radius_m[1] / TYPICAL.edge_radius_m[1]  # of what ``BuiltTolerance`` has no word for
    mm = np.array([t.pin_lateral_m, t.pin_lateral_m, t.pin_axial_m]) * 1e3
    pins = tuple(
        Pin(p.x_mm + dx, p.y_mm + dy, p.radius_mm, p.tip_mm + dz)
        for p, (dx, dy, dz) in zip(PINS, off * mm, strict=True)
    )
    leans = tuple((float(a), float(b)) for a, b in rough * rng.normal(0.0, 0.25, (len(PINS), 2)))
    x, y, z = 1.0 + rng.normal(0.0, t.shrink, 3)
    part = _Part(
        pins if contacts else (),
        leans if contacts else (),
        FACE_MM + float(rng.normal(0.0, t.face_m)) * 1e3,
        FLOOR_MM + float(rng.normal(0.0, t.floor_m)) * 1e3,
        LEAD_IN_MM + rough * float(rng.uniform(-0.1, 0.1)),
        0.02 + float(rng.normal(0.0, t.draft_rad)),
        rough * float(rng.uniform(-0.3, 0.3)),
        (float(x), float(y), float(z)),
    )
    return _mesh(part)


def _mesh(part: _Part) -> PortMesh:
    parts: dict[int, int] = {}

    def named(name: str, solid: Manifold) -> Manifold:
        one = solid.as_original()
        parts[one.original_id()] = PARTS.index(name)
        return one

    solid = named("rim", _prism(_collar(0.0), 0.0, BACK_MM)) + named("flange", _flange())
    lean = part.wall_lean_rad * part.floor_mm
    solid -= named("cavity", _between(_collar(-WALL_MM + part.lead_in_mm), _collar(-WALL_MM), -0.001, part.lead_in_mm))
    solid -= named(
        "cavity", _between(_collar(-WALL_MM), _collar(-WALL_MM - lean), part.lead_in_mm - 0.01, part.floor_mm)
    )
    solid += named("insert", _carrier(part))
    for pin in PINS:  # wells are there even where contacts are missing
        well = _between(_disc(pin, pin.radius_mm + 1.0), _disc(pin, pin.radius_mm + 0.7), 0.0, WELL_FLOOR_MM)
        solid -= named("well", well)
    for pin, lean_deg in zip(part.pins, part.leans_deg, strict=True):
        solid += named("pin", _pin(pin, lean_deg))
    solid += named("key", _prism(CrossSection.hull_points(np.array(KEY_MM)), part.floor_mm / 3.0, part.floor_mm + 1.0))
    mesh = labelled_mesh(solid, parts)
    return replace(mesh, vertices=_as_built(mesh.vertices * 1e3, part) / 1e3)


def _as_built(vertices: Array, part: _Part) -> Array:
    """Bowed flange, and shrinkage along each axis."""
    beyond = np.clip((np.hypot(vertices[:, 0], vertices[:, 1]) - 29.0) / 12.0, 0.0, None)
    return np.asarray((vertices + np.array([0.0, 0.0, 1.0]) * (part.bow_mm * beyond**2)[:, None]) * part.scale)


def _collar(grow: float) -> CrossSection:
    return CrossSection.batch_hull([CrossSection.circle(r + grow, ROUND).translate((x, y)) for x, y, r in LOBES_MM])


def _disc(pin: Pin, radius: float) -> CrossSection:
    return CrossSection.circle(radius, ROUND // 2).translate((pin.x_mm, pin.y_mm))


def _prism(section: CrossSection, top: float, bottom: float) -> Manifold:
    return section.extrude(bottom - top).translate((0.0, 0.0, -bottom))


def _between(upper: CrossSection, lower: CrossSection, top: float, bottom: float) -> Manifold:
    """The hull of two sections at two depths."""
    return Manifold.batch_hull([_prism(upper, top, top + 0.001), _prism(lower, bottom - 0.001, bottom)])


def _flange() -> Manifold:
    plate = _prism(CrossSection.circle(FLANGE_RADIUS_MM, 6), FLANGE_FRONT_MM, FLANGE_FRONT_MM + FLANGE_THICK_MM)
    plate = plate.refine_to_length(4.0)  # so that it can be bowed
    for x, y in BOLTS_MM:
        plate -= _prism(CrossSection.circle(2.7, ROUND // 2).translate((x, y)), 0.0, BACK_MM)
        plate -= _prism(CrossSection.circle(4.8, ROUND // 2).translate((x, y)), 0.0, FLANGE_FRONT_MM + 1.4)
    return plate


def _carrier(part: _Part) -> Manifold:
    column = _prism(
        CrossSection.circle(FACE_RADIUS_MM, ROUND).scale((1.1, 1.0)), part.face_mm - 2.0, part.floor_mm + 1.0
    )
    ball = Manifold.sphere(DOME_RADIUS_MM, 4 * ROUND).translate((0.0, 0.0, -part.face_mm - DOME_RADIUS_MM))
    return column ^ ball


def _pin(pin: Pin, lean_deg: tuple[float, float]) -> Manifold:
    length = WELL_FLOOR_MM + 1.0 - pin.tip_mm
    ball = Manifold.sphere(pin.radius_mm, ROUND // 2).translate((0.0, 0.0, length - pin.radius_mm))
    upright = Manifold.cylinder(length - pin.radius_mm, pin.radius_mm, pin.radius_mm, ROUND // 2) + ball
    return upright.rotate((*lean_deg, 0.0)).translate((pin.x_mm, pin.y_mm, -WELL_FLOOR_MM - 1.0))


def _shape() -> PortShape:
    rim = Hull(tuple(Disc(2e-3 * r, (1e-3 * x, 1e-3 * y)) for x, y, r in LOBES_MM))
    opening = Hull(tuple(Disc(2e-3 * (r - WALL_MM), (1e-3 * x, 1e-3 * y)) for x, y, r in LOBES_MM))
    side = 2e-3 * FLANGE_RADIUS_MM
    contacts = tuple(
        Contact(f"contact {k}", (1e-3 * p.x_mm, 1e-3 * p.y_mm), 2e-3 * p.radius_mm, 1e-3 * p.tip_mm)
        for k, p in enumerate(PINS)
    )
    return PortShape(
        NAME,
        rim,
        Cavity(opening, 1e-3 * FLOOR_MM),
        Flange(RoundedRect(side, side, 0.005), 1e-3 * FLANGE_FRONT_MM, 1e-3 * FLANGE_THICK_MM),
        (Insert(Disc(2e-3 * FACE_RADIUS_MM), 1e-3 * FACE_MM),),
        contacts,
    )


SHAPE = _shape()
"""Its main dimensions in the terms of the other ports: what the vehicle, a cap or a plug around it needs to know."""
