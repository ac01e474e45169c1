"""The inlet as it was built: the nominal shape with the deviations that moulding and assembly bring.

A locator that is tested against the very mesh it searches for learns nothing about real parts, so every simulated
vehicle carries a variant: draft, rounded edges, pins off their place, depths and diameters within their tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from perception.port_shape import Cavity, Contact, Finish, Insert, PortShape


@dataclass(frozen=True, slots=True)
class BuiltTolerance:
    """Standard deviations of a built inlet's deviations from its drawing, and what its edges look like."""

    shrink: float = 0.0003
    """Relative error of the overall scale."""
    pin_lateral_m: float = 0.00005
    pin_axial_m: float = 0.00015
    diameter_m: float = 0.00005
    """Of wells and bores."""
    face_m: float = 0.0001
    """Depth of the inserts' faces."""
    floor_m: float = 0.0003
    """Depth of the floors."""
    draft_rad: float = float(np.deg2rad(0.1))
    edge_radius_m: tuple[float, float] = (0.00010, 0.00030)
    """Range of the radius that moulding adds to the drawing's edges."""

    @staticmethod
    def none() -> BuiltTolerance:
        """The drawing itself: sharp edges, no draft, no deviation."""
        return BuiltTolerance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0))


TYPICAL = BuiltTolerance()


def built_variant(shape: PortShape, tolerance: BuiltTolerance, rng: np.random.Generator) -> PortShape:
    """One built example of ``shape``; the overall shrink is left to the mesh (see ``shrink_factor``)."""
    contacts = tuple(_built_contact(contact, tolerance, rng) for contact in shape.contacts)
    inserts = tuple(_built_insert(insert, tolerance, rng) for insert in shape.inserts)
    cavity = Cavity(shape.cavity.outline, shape.cavity.depth_m + rng.normal(0.0, tolerance.floor_m))
    draft = max(shape.finish.draft_rad + rng.normal(0.0, tolerance.draft_rad), 0.0)
    finish = Finish(float(draft), shape.finish.edge_radius_m + float(rng.uniform(*tolerance.edge_radius_m)))
    return replace(shape, cavity=cavity, inserts=inserts, contacts=contacts, finish=finish)


def shrink_factor(tolerance: BuiltTolerance, rng: np.random.Generator) -> float:
    """By how much the built inlet is larger than its drawing, as a factor."""
    return float(1.0 + rng.normal(0.0, tolerance.shrink))


def _built_contact(contact: Contact, tolerance: BuiltTolerance, rng: np.random.Generator) -> Contact:
    dx, dy = rng.normal(0.0, tolerance.pin_lateral_m, 2)
    well = contact.well_diameter_m
    return replace(
        contact,
        centre_m=(contact.centre_m[0] + dx, contact.centre_m[1] + dy),
        tip_depth_m=max(contact.tip_depth_m + rng.normal(0.0, tolerance.pin_axial_m), 0.0),
        well_diameter_m=None if well is None else well + rng.normal(0.0, tolerance.diameter_m),
    )


def _built_insert(insert: Insert, tolerance: BuiltTolerance, rng: np.random.Generator) -> Insert:
    return Insert(insert.outline, max(insert.face_depth_m + rng.normal(0.0, tolerance.face_m), 0.0))
