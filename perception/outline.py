"""Convex plane outlines and the solids that are drawn through them: what a port and a vehicle are built from.

Outlines are values in metres. The solids are ``manifold3d`` ones in millimetres (its tolerances suit numbers of order
one); a *depth* is -z. A full disc is turned in one piece; every other solid is a stack of convex hulls, so tapers,
chamfers and rounded edges are a matter of how much the outline grows from one depth to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold, OpType

from perception.errors import MeshError
from perception.geometry import Array

Point2 = tuple[float, float]

CHORD_ERROR_M = 0.02e-3
"""How far a tessellated curved wall may lie inside the true one."""
MM = 1000.0
"""Millimetres in a metre."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A circle, if ``flat_top_m`` is given cut off by a horizontal line that high above its centre."""

    diameter_m: float
    centre_m: Point2 = (0.0, 0.0)
    flat_top_m: float | None = None


@dataclass(frozen=True, slots=True)
class RoundedRect:
    """A rectangle with rounded corners; a stadium where the radius is half the smaller side."""

    width_m: float
    height_m: float
    corner_radius_m: float
    centre_m: Point2 = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Hull:
    """The smallest convex outline around several."""

    parts: tuple[Outline, ...]


@dataclass(frozen=True, slots=True)
class Common:
    """What several outlines have in common."""

    parts: tuple[Outline, ...]


Outline: TypeAlias = Disc | RoundedRect | Hull | Common


def loft_mm(outline: Outline, stations: Sequence[tuple[float, float]]) -> Manifold:
    """The solid through ``outline`` grown by each station's offset at its depth: (depth, offset) in mm, for scenes."""
    return union(slabs(outline, stations))


def slabs(outline: Outline, stations: Sequence[tuple[float, float]]) -> list[Manifold]:
    """Convex slabs between one station and the next; a full disc is turned in one piece, which is much faster."""
    if isinstance(outline, Disc) and outline.flat_top_m is None:
        return [_turned(outline, stations)]
    rings = [_ring(outline, depth, grow) for depth, grow in stations]
    return [Manifold.hull_points(np.vstack(pair)) for pair in pairwise(rings)]


def _turned(disc: Disc, stations: Sequence[tuple[float, float]]) -> Manifold:
    """The solid of revolution with the disc's radius, grown by each station's offset, at its depth."""
    radius = disc.diameter_m * MM / 2
    rows = [(radius + grow, -depth) for depth, grow in stations]
    if min(row[0] for row in rows) <= 0:
        raise MeshError("a circle of the port has no size", remedy="Check its diameters, drafts and edge radii.")
    profile = np.array([(0.0, rows[-1][1]), *reversed(rows), (0.0, rows[0][1])])
    solid = Manifold.revolve(_polygon(profile), _segments(max(row[0] for row in rows)))
    return solid.translate((disc.centre_m[0] * MM, disc.centre_m[1] * MM, 0.0)).as_original()


def union(solids: Sequence[Manifold]) -> Manifold:
    """All solids as one."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def outline_bounds(outline: Outline) -> tuple[float, float, float, float]:
    """(smallest x, smallest y, largest x, largest y) of an outline in metres."""
    low_x, low_y, high_x, high_y = _section(outline, 0.0).bounds()
    return low_x / MM, low_y / MM, high_x / MM, high_y / MM


def _ring(outline: Outline, depth: float, grow: float) -> Array:
    """Corner points (N, 3) in mm of the outline grown by ``grow`` mm, at ``depth`` mm."""
    polygons = _section(outline, grow).to_polygons()
    if not polygons:
        raise MeshError("an outline of the port vanishes", remedy="Check its diameters, sides and radii.")
    xy = np.vstack(polygons)
    return np.column_stack([xy, np.full(len(xy), -depth)])


def _section(outline: Outline, grow: float) -> CrossSection:
    """The outline as a plane region in mm, moved outwards by ``grow`` mm."""
    match outline:
        case Disc(diameter, centre, flat):
            circle = _polygon(_arc(diameter * MM / 2 + grow, centre))
            if flat is None:
                return circle
            reach = diameter * MM + abs(grow)
            keep = CrossSection.square((4 * reach, 4 * reach)).translate((-2 * reach, -4 * reach))
            return circle ^ keep.translate((centre[0] * MM, (centre[1] + flat) * MM + grow))
        case RoundedRect(width, height, radius, centre):
            return _rounded_rect(width * MM + 2 * grow, height * MM + 2 * grow, radius * MM + grow, centre)
        case Hull(parts):
            return CrossSection.batch_hull([_section(part, grow) for part in parts])
        case Common(parts):
            region = _section(parts[0], grow)
            for part in parts[1:]:
                region = region ^ _section(part, grow)
            return region


def _rounded_rect(width: float, height: float, radius: float, centre: Point2) -> CrossSection:
    """A rectangle with rounded corners as the hull of its four corner circles; all in mm but ``centre`` (m)."""
    radius = float(np.clip(radius, 1e-3, min(width, height) / 2))
    x, y = width / 2 - radius, height / 2 - radius
    corners = [(centre[0] + sx * x / MM, centre[1] + sy * y / MM) for sx in (-1, 1) for sy in (-1, 1)]
    return CrossSection.batch_hull([_polygon(_arc(radius, corner)) for corner in corners])


def _arc(radius: float, centre: Point2) -> Array:
    """Points (N, 2) in mm on a circle of ``radius`` mm, as many as the chord error asks for."""
    if radius <= 0:
        raise MeshError("a circle of the port has no size", remedy="Check its diameters, drafts and edge radii.")
    count = _segments(radius)
    angle = np.arange(count) * (2 * np.pi / count)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius + np.array(centre) * MM


def _segments(radius: float) -> int:
    """Into how many sides a circle of ``radius`` mm is divided."""
    ratio = min(CHORD_ERROR_M * MM / radius, 0.2)
    return 4 * int(np.ceil(np.pi / np.arccos(1 - ratio) / 4))


def _polygon(points: Array) -> CrossSection:
    return CrossSection([points], FillRule.Positive)
