"""A vehicle inlet as numbers: outlines, depths, contacts. ``port_solid`` makes the surface that they describe.

Port frame: origin on the rim plane at the centre of the AC section, +z out of the vehicle, +y up, +x right for someone
who looks into the port. A *depth* is counted from the rim plane into the vehicle, so it is -z. Every outline is convex
(``outline``); what is not (a latch slot, a key) is a ``Key`` that is cut or added. Knows nothing
of the vehicle around the inlet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from perception.geometry import Pose
from perception.outline import MM, Common, Disc, Hull, Outline, Point2, RoundedRect, outline_bounds

_WALL_MM = 3.0  # thickness behind the deepest floor; never seen


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
    """Of ``port_solid.PARTS``: what the standard fixes; the others vary between makes and must not decide the pose."""

    @property
    def T_port_tcp(self) -> Pose:
        """Pose of the mated plug: TCP z into the vehicle, TCP x along port x, origin on the plug's foremost face."""
        return Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -self.mated_depth_m]))


__all__ = [
    "Cavity",
    "Common",
    "Contact",
    "Disc",
    "Finish",
    "Flange",
    "Hole",
    "Hull",
    "Insert",
    "Key",
    "Outline",
    "Point2",
    "PortDescription",
    "PortShape",
    "RoundedRect",
    "outline_bounds",
]
