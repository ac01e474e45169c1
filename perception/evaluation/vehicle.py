"""The vehicle around an inlet, as solids: panel, charging pocket, cover, things in the way, and what is no port at all.

Everything is placed in the port frame and modelled in millimetres (suffix _mm, or a ``Manifold``). The vehicle is a
plausible one, not a particular one: sizes are drawn from ranges with an injected generator.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, cast

import numpy as np
from manifold3d import Manifold

from perception.geometry import Array
from perception.outline import Disc, RoundedRect, loft_mm, outline_bounds
from perception.port_shape import PortShape

Side = Literal["left", "right", "top", "bottom"]
SIDES: tuple[Side, ...] = ("left", "right", "top", "bottom")
Occluder = Literal["cable", "hand", "box"]
Rng = np.random.Generator

_MM = 1000.0
_PANEL_MM = 560.0
_GRID_MM = 20.0
_QUARTER_TURNS: dict[Side, int] = {"left": 0, "bottom": 1, "right": 2, "top": 3}


@dataclass(frozen=True, slots=True)
class Pocket:
    """The recess that the inlet sits in, and the panel around it. Millimetres, port frame."""

    outline: RoundedRect
    """At the floor."""
    floor_z_mm: float
    panel_z_mm: float
    """Height of the panel's surface over the rim plane, at the port."""
    radii_mm: tuple[float, float]
    """Radii of the panel's curvature along x and y."""
    wall_slope: float
    """How much wider the pocket gets for each millimetre towards its mouth."""

    def panel_height_mm(self, x: float, y: float) -> float:
        """z of the panel's surface at a place."""
        return self.panel_z_mm - x**2 / (2 * self.radii_mm[0]) - y**2 / (2 * self.radii_mm[1])

    @property
    def mouth_mm(self) -> tuple[float, float, float, float]:
        """(smallest x, smallest y, largest x, largest y) of the pocket's mouth."""
        grow = self.wall_slope * (self.panel_z_mm - self.floor_z_mm)
        low_x, low_y, high_x, high_y = (value * _MM for value in outline_bounds(self.outline))
        return low_x - grow, low_y - grow, high_x + grow, high_y + grow


def draw_pocket(shape: PortShape, panel_height_m: tuple[float, float], rng: Rng) -> Pocket:
    """A pocket that fits around ``shape``."""
    face = shape.rim if shape.flange is None else shape.flange.outline
    low_x, low_y, high_x, high_y = outline_bounds(face)
    margin = rng.uniform(0.006, 0.022, 2)
    width, height = high_x - low_x + 2 * margin[0], high_y - low_y + 2 * margin[1]
    centre = ((low_x + high_x) / 2 + rng.uniform(-0.003, 0.003), (low_y + high_y) / 2 + rng.uniform(-0.003, 0.003))
    depth = 0.010 if shape.flange is None else shape.flange.front_depth_m
    return Pocket(
        outline=RoundedRect(width, height, float(rng.uniform(0.012, 0.030)), centre),
        floor_z_mm=-depth * _MM - float(rng.uniform(0.5, 3.5)),
        panel_z_mm=float(rng.uniform(*panel_height_m)) * _MM,
        radii_mm=(float(rng.uniform(1500, 5000)), float(rng.uniform(900, 4000))),
        wall_slope=float(rng.uniform(0.03, 0.25)),
    )


def panel(pocket: Pocket) -> Manifold:
    """The curved outer skin, as a thick slab without any opening."""
    bottom, top = -90.0, pocket.panel_z_mm
    slab = Manifold.cube((_PANEL_MM, _PANEL_MM, top - bottom)).translate((-_PANEL_MM / 2, -_PANEL_MM / 2, bottom))

    def bend(points: Array) -> Array:
        bent = points.copy()
        bent[:, 2] -= points[:, 0] ** 2 / (2 * pocket.radii_mm[0]) + points[:, 1] ** 2 / (2 * pocket.radii_mm[1])
        return bent

    return slab.refine_to_length(_GRID_MM).warp_batch(bend)


def recess(pocket: Pocket) -> Manifold:
    """What is cut out of the panel for the pocket: wider at its mouth."""
    height = pocket.panel_z_mm - pocket.floor_z_mm + 5.0
    return loft_mm(
        pocket.outline, [(-pocket.floor_z_mm - height, pocket.wall_slope * height), (-pocket.floor_z_mm, 0.0)]
    )


def body_hole(shape: PortShape) -> Manifold:
    """The hole in the pocket's floor through which the inlet's body passes."""
    return loft_mm(shape.rim, [(-1.0, 1.0), (shape.back_depth_m * _MM + 1.0, 1.0)])


def open_cover(pocket: Pocket, hinge: Side, opening_rad: float, rng: Rng) -> Manifold:
    """The charging flap, turned open by ``opening_rad`` about its hinge beside the pocket."""
    low_x, low_y, high_x, high_y = pocket.mouth_mm
    turns = _QUARTER_TURNS[hinge]
    across, along = (high_x - low_x, high_y - low_y) if turns % 2 == 0 else (high_y - low_y, high_x - low_x)
    thick, overlap = float(rng.uniform(2.5, 6.0)), 4.0
    size = (across + 2 * overlap, along + 2 * overlap)
    radius = min(pocket.outline.corner_radius_m + 0.004, min(size) / 2 / _MM)
    flat = RoundedRect(size[0] / _MM, size[1] / _MM, radius, (size[0] / 2 / _MM, 0.0))
    plate = loft_mm(flat, [(-thick, -1.0), (-thick + 1.0, 0.0), (0.0, 0.0)])
    opened = plate.rotate((0.0, -float(np.rad2deg(opening_rad)), 0.0)).translate((-across / 2 - overlap, 0.0, 0.0))
    x, y = (low_x + high_x) / 2, (low_y + high_y) / 2
    return opened.rotate((0.0, 0.0, 90.0 * turns)).translate((x, y, pocket.panel_height_mm(x, y) + 1.0))


def closed_cover_gap(pocket: Pocket) -> Manifold:
    """The groove around a closed flap, to be cut out of a plain panel."""
    outline, top = pocket.outline, -pocket.panel_z_mm - 5.0
    ring = loft_mm(outline, [(top, 7.0), (top + 15.0, 7.0)])
    return ring - loft_mm(outline, [(top - 1.0, 4.0), (top + 16.0, 4.0)])


def dust_cap(shape: PortShape, rng: Rng) -> Manifold:
    """A cap over the inlet: pulled over the rim, set flush into the cavity, or only over the contacts."""
    style = int(rng.integers(3))
    if style == 0:
        top = -float(rng.uniform(1.5, 5.0))
        tab = Disc(0.014, (0.0, outline_bounds(shape.rim)[3] + 0.004))
        return loft_mm(shape.rim, [(top, 0.0), (top + 1.5, 1.5), (4.0, 1.5)]) + loft_mm(tab, [(top, 0.0), (3.0, 0.0)])
    if style == 1:
        face = float(rng.uniform(-0.5, 3.0))
        return loft_mm(shape.cavity.outline, [(face, -1.0), (face + 0.8, -0.2), (20.0, -0.2)])
    outlines = [insert.outline for insert in shape.inserts] or [shape.cavity.outline]
    depth = min((insert.face_depth_m for insert in shape.inserts), default=0.004) * _MM - float(rng.uniform(0.0, 0.8))
    return _union([loft_mm(outline, [(depth, -0.3), (depth + 12.0, -0.3)]) for outline in outlines])


def inserted_plug(shape: PortShape, rng: Rng) -> Manifold:
    """A charging plug in the inlet: its shroud, a tapering body and the handle that leads down and away."""
    outline = shape.cavity.outline
    low_x, low_y, high_x, high_y = (value * _MM for value in outline_bounds(outline))
    length = float(rng.uniform(35.0, 60.0))
    shroud = loft_mm(outline, [(-length, -6.0), (-8.0, -1.0), (-7.0, -2.1), (shape.cavity.depth_m * _MM - 12.0, -2.1)])
    x, y = (low_x + high_x) / 2, (low_y + high_y) / 2
    grip = min(high_x - low_x, high_y - low_y) * 0.33
    path = np.array([[x, y, length - 12.0], [x, y - 25.0, length + 45.0], [x, y - 90.0, length + 85.0]])
    return shroud + _tube(path, np.array([grip, grip * 0.9, grip * 0.8]))


def other_recess(pocket: Pocket, rng: Rng) -> tuple[Manifold, Manifold]:
    """(what is cut, what is added) for a recess that is no charging port: a filler neck or a trailer socket."""
    floor = -pocket.floor_z_mm
    if rng.random() < 0.5:
        cut = loft_mm(Disc(float(rng.uniform(0.055, 0.080))), [(floor - 1.0, 1.0), (floor + 35.0, -2.0)])
        neck = loft_mm(
            Disc(float(rng.uniform(0.030, 0.048))), [(floor + rng.uniform(-8.0, 10.0), 0.0), (floor + 40.0, 0.5)]
        )
        ribs = loft_mm(RoundedRect(0.028, 0.007, 0.003), [(floor - 14.0, 0.0), (floor + 2.0, 0.0)])
        return cut, neck + ribs
    size = float(rng.uniform(0.045, 0.070))
    cut = loft_mm(RoundedRect(size, size * 0.9, 0.008), [(floor - 1.0, 0.5), (floor + 30.0, -1.0)])
    posts = [Disc(0.007, (float(dx), float(dy))) for dx, dy in rng.uniform(-size / 3, size / 3, (4, 2))]
    return cut, _union([loft_mm(post, [(floor + 10.0, -0.5), (floor + 32.0, 0.0)]) for post in posts])


def occluder(kind: Occluder, reach_mm: float, rng: Rng) -> Manifold:
    """Something between scanner and port; ``reach_mm``: the half width that it should leave mostly free."""
    turn, height = float(rng.uniform(0.0, 360.0)), float(rng.uniform(45.0, 95.0))
    aside = float(rng.uniform(0.55, 1.15)) * reach_mm
    if kind == "cable":
        t = np.linspace(-1.0, 1.0, 9)
        path = np.column_stack([aside + 18.0 * t**2, 230.0 * t, height + 12.0 * np.sin(2.0 * t + turn)])
        solid = _tube(path, np.full(len(t), float(rng.uniform(4.0, 8.0))))
    elif kind == "box":
        solid = _box((85.0, 100.0, 30.0), (aside + 45.0, 0.0, height))
    else:
        solid = _hand(rng).translate((aside + 45.0, 0.0, height))
    return solid.rotate((0.0, 0.0, turn))


def clutter(pocket: Pocket, rng: Rng) -> Manifold:
    """A trim, bracket or strip on the panel beside the pocket."""
    low_x, _, high_x, _ = pocket.mouth_mm
    right = rng.random() < 0.5
    x = (high_x + rng.uniform(10.0, 45.0)) if right else (low_x - rng.uniform(10.0, 45.0))
    size = (float(rng.uniform(8.0, 25.0)), float(rng.uniform(60.0, 400.0)), float(rng.uniform(4.0, 35.0)))
    top = pocket.panel_height_mm(x, 0.0) + size[2] / 2
    strip = _box(size, (0.0, 0.0, 0.0)).rotate((0.0, 0.0, float(rng.normal(0.0, 8.0))))
    return strip.translate((float(x), float(rng.uniform(-60.0, 60.0)), top))


def _hand(rng: Rng) -> Manifold:
    """A palm with four fingers, pointing towards -x."""
    palm = _box((85.0, 82.0, 26.0), (25.0, 0.0, 0.0))
    fingers = []
    for k in range(4):
        root, length = -30.0 + 20.0 * k, float(rng.uniform(55.0, 80.0))
        path = np.array([[-10.0, root, 0.0], [-20.0 - length, root * 1.15, float(rng.uniform(-12.0, 2.0))]])
        fingers.append(_tube(path, np.array([9.0, 7.5])))
    return _union([palm, *fingers])


def _box(size: tuple[float, float, float], centre: tuple[float, float, float]) -> Manifold:
    return Manifold.cube(size, True).translate(centre)


def _tube(path: Array, radius: Array) -> Manifold:
    """A round tube along a path (K, 3) with a radius at each point, all in mm."""
    balls = [Manifold.sphere(float(r), 20).translate(tuple(p)) for p, r in zip(path, radius, strict=True)]
    return _union([Manifold.batch_hull([a, b]) for a, b in pairwise(balls)])


def _union(solids: list[Manifold]) -> Manifold:
    return cast(Manifold, sum(solids[1:], solids[0]))
