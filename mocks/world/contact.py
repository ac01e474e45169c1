"""How a plug meets a port: wrench and outcome from the plug's true pose in the true port frame.

Quasi-static and deliberately simple, so that the outcome can be told beforehand from the misalignment alone: whether
the plug enters is decided when its face crosses the rim plane. Outside the capture range it lands on the vehicle's
face, where friction holds it against small forces across but not against a search. Inside, lead-in chamfers centre it
(springs across, about the axis and in tilt), friction resists along the axis, rises with depth, lets go just before
home (the seating click), and a hard stop ends the way; so does whatever blocks the port. A locked latch holds a plug
that is home. The stiffness stands for arm, bracket, plug and inlet together.

Not simulated: single contacts and pins, deformation and damage, the cable's pull, dynamics and impact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mocks.spatial import rotvec_of
from mocks.world.blackboard import PlugState
from perception.geometry import Array, Pose

Outcome = Literal["mates", "blocked"]


@dataclass(frozen=True, slots=True)
class ContactParameters:
    """What the pair of plug and port does; lengths in m, forces in N."""

    capture_radius_m: float = 0.0025
    capture_tilt_rad: float = math.radians(2.5)
    capture_roll_rad: float = math.radians(3.0)
    clearance_m: float = 0.0002
    clearance_rad: float = math.radians(0.3)
    chamfer_m: float = 0.005
    """Depth over which the lead-in takes full effect."""
    stop_stiffness: float = 60e3
    face_stiffness: float = 20e3
    """Of the bodywork around the port, softer than the port's end."""
    lateral_stiffness: float = 10e3
    tilt_stiffness: float = 100.0
    """Nm/rad."""
    roll_stiffness: float = 60.0
    friction_entry_n: float = 4.0
    friction_peak_n: float = 40.0
    friction_home_n: float = 12.0
    click_m: float = 0.002
    """This far before home the axial friction peaks."""
    pull_share: float = 0.8
    """Friction on the way out, as a share of that on the way in."""
    friction_stiffness: float = 100e3
    jam_coefficient: float = 0.3
    """Axial friction for each newton across."""
    jam_lever_m: float = 0.05
    """Moments count as a pair of lateral forces on this lever."""
    latch_play_m: float = 0.0003
    seated_within_m: float = 0.0005
    face_friction: float = 0.1
    """Force across that the face takes up, as a share of the force on it; moments on ``jam_lever_m``."""
    face_radius_m: float = 0.3
    """The vehicle's face around the port; beyond it there is nothing to touch."""


@dataclass(frozen=True, slots=True, eq=False)
class Port:
    """The true port as the plug meets it. ``T_port_tcp`` is the plug's pose when fully mated."""

    T_port_tcp: Pose
    exists: bool = True
    """False on a plain panel: nothing to enter."""
    blocked_depth_m: float | None = None
    parameters: ContactParameters = ContactParameters()

    @property
    def mated_depth_m(self) -> float:
        """Depth of the plug's face below the rim plane when home."""
        return -float(self.T_port_tcp.translation[2])

    @property
    def end_depth_m(self) -> float:
        """Depth at which something hard ends the way."""
        blocked = self.blocked_depth_m
        return self.mated_depth_m if blocked is None else min(blocked, self.mated_depth_m)


@dataclass(frozen=True, slots=True, eq=False)
class Misalignment:
    """Where the plug is against where it would be when home, in port axes."""

    depth_m: float
    """Of the plug's face below the rim plane."""
    lateral: Array
    """(2,) m."""
    rotvec: Array
    """(3,) rad; its third component is the roll."""

    @property
    def lateral_m(self) -> float:
        """Distance of the axes."""
        return float(np.hypot(self.lateral[0], self.lateral[1]))

    @property
    def tilt_rad(self) -> float:
        """Angle between the axes."""
        return float(np.hypot(self.rotvec[0], self.rotvec[1]))

    @property
    def roll_rad(self) -> float:
        """Turn about the axis."""
        return float(self.rotvec[2])


@dataclass(frozen=True, slots=True)
class ContactState:
    """What one step hands on to the next."""

    captured: bool = False
    held: bool = False
    """The latch closed while the plug was home."""
    anchor_m: float = 0.0
    """Depth at which axial friction would be relaxed."""
    face_anchor: tuple[float, ...] | None = None
    """Where (x, y) and how turned (rotation vector) the plug would rest on the face without friction's pull."""


def misalignment(T_port_tcp: Array, port: Port) -> Misalignment:
    """Misalignment of a plug at ``T_port_tcp`` (4, 4)."""
    mated = port.T_port_tcp
    offset = T_port_tcp[:3, 3] - mated.translation
    rotvec = rotvec_of(T_port_tcp[:3, :3] @ mated.rotation.T)
    return Misalignment(port.mated_depth_m - float(offset[2]), offset[:2].copy(), rotvec)


def is_captured(plug: Misalignment, port: Port) -> bool:
    """Whether the lead-in takes the plug."""
    p = port.parameters
    return (
        port.exists
        and plug.lateral_m <= p.capture_radius_m
        and plug.tilt_rad <= p.capture_tilt_rad
        and abs(plug.roll_rad) <= p.capture_roll_rad
    )


def predict_outcome(plug: Misalignment, port: Port) -> Outcome:
    """What a push straight along the port's axis, compliant in the other five, comes to; depth is ignored.

    ``mates`` exactly when the misalignment is within capture and nothing blocks the port. An arm that does not yield
    may jam where this says ``mates``; a search that moves the plug across the face may mate where it says ``blocked``.
    """
    return "mates" if is_captured(plug, port) and port.end_depth_m >= port.mated_depth_m else "blocked"


def step(state: ContactState, plug: Misalignment, port: Port, locked: bool) -> tuple[ContactState, Array, PlugState]:
    """Next state, wrench (6,) on the plug at its TCP in port axes (N, Nm), and what to tell the others."""
    state = _enter_or_leave(state, plug, port)
    if state.captured:
        state, wrench = _inside(state, plug, port, locked)
    else:
        state, wrench = _on_face(state, plug, port)
    home = plug.depth_m >= port.mated_depth_m - port.parameters.seated_within_m
    told = PlugState(
        depth_m=plug.depth_m,
        lateral_m=plug.lateral_m,
        roll_rad=plug.roll_rad,
        tilt_rad=plug.tilt_rad,
        seated=state.captured and home,
        force_n=float(np.linalg.norm(wrench[:3])),
    )
    return state, wrench, told


def axial_friction_n(depth_m: float, port: Port) -> float:
    """Largest axial friction on the way in, by depth alone: rises to the click, then lets go."""
    p = port.parameters
    click = port.mated_depth_m - p.click_m
    if depth_m <= click:
        rise = math.pow(max(depth_m, 0.0) / click, 1.5)
        return p.friction_entry_n + (p.friction_peak_n - p.friction_entry_n) * rise
    share = min(1.0, (depth_m - click) / p.click_m)
    return p.friction_peak_n + (p.friction_home_n - p.friction_peak_n) * share


def _enter_or_leave(state: ContactState, plug: Misalignment, port: Port) -> ContactState:
    if not state.captured and plug.depth_m > 0.0 and is_captured(plug, port):
        return ContactState(captured=True, anchor_m=plug.depth_m)
    if state.captured and plug.depth_m < -0.0005:
        return ContactState()
    return state


def _on_face(state: ContactState, plug: Misalignment, port: Port) -> tuple[ContactState, Array]:
    p = port.parameters
    wrench = np.zeros(6)
    if plug.depth_m <= 0.0 or plug.lateral_m >= p.face_radius_m:
        return ContactState(), wrench
    wrench[2] = p.face_stiffness * plug.depth_m
    here = np.concatenate([plug.lateral, plug.rotvec])
    pull = here - (here if state.face_anchor is None else np.array(state.face_anchor))
    hold = p.face_friction * wrench[2]
    pull[:2] = _within(pull[:2], hold / p.lateral_stiffness)
    pull[2:] = _within(pull[2:], hold * p.jam_lever_m / p.tilt_stiffness)
    wrench[:2] = -p.lateral_stiffness * pull[:2]
    wrench[3:] = -p.tilt_stiffness * pull[2:]
    return ContactState(face_anchor=tuple(float(value) for value in here - pull)), wrench


def _inside(state: ContactState, plug: Misalignment, port: Port, locked: bool) -> tuple[ContactState, Array]:
    p = port.parameters
    lead_in = min(1.0, max(0.0, plug.depth_m / p.chamfer_m))
    wrench = np.zeros(6)
    wrench[:2] = -lead_in * p.lateral_stiffness * _beyond(plug.lateral, p.clearance_m)
    wrench[3:5] = -lead_in * p.tilt_stiffness * _beyond(plug.rotvec[:2], p.clearance_rad)
    wrench[5:] = -lead_in * p.roll_stiffness * _beyond(plug.rotvec[2:], p.clearance_rad)
    across = float(np.linalg.norm(wrench[:2])) + float(np.linalg.norm(wrench[3:])) / p.jam_lever_m

    friction = axial_friction_n(plug.depth_m, port) + p.jam_coefficient * across
    stretch = plug.depth_m - state.anchor_m
    stretch = max(-p.pull_share * friction, min(friction, p.friction_stiffness * stretch)) / p.friction_stiffness
    wrench[2] = p.friction_stiffness * stretch + p.stop_stiffness * max(0.0, plug.depth_m - port.end_depth_m)

    held = locked and (state.held or plug.depth_m > port.mated_depth_m - p.click_m)
    if held:
        wrench[2] -= p.stop_stiffness * max(0.0, port.mated_depth_m - p.latch_play_m - plug.depth_m)
    return replace(state, held=held, anchor_m=plug.depth_m - stretch), wrench


def _within(vector: Array, limit: float) -> Array:
    """A vector shortened to a limit."""
    size = float(np.linalg.norm(vector))
    return vector * (limit / size) if size > limit else vector


def _beyond(vector: Array, play: float) -> Array:
    """The part of a deviation that goes beyond the play."""
    size = float(np.linalg.norm(vector))
    return vector * (1.0 - play / size) if size > play else np.zeros_like(vector)
