"""Clearance of an arm from itself and from boxes, with each link as a capsule: pure and vectorised over poses.

Coarse on purpose: it refuses motions that fold the arm into itself or sweep it through the open cover or the
vehicle's panel. It is no safety function, and a clearance of centimetres is not measured to millimetres. Link offsets
are those of Universal Robots' published models; radii are taken generously from their outlines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arm.kinematics import ArmModel, frames_many
from drivers.base import Box
from perception.geometry import Array

LINKS = ("base", "shoulder", "upper arm", "elbow", "forearm", "wrist 1", "wrist 2", "wrist 3", "tool", "plug")
TOOL = LINKS.index("tool")

_SELF_PAIRS = np.array(
    [(0, k) for k in (4, 5, 6, 7, 8, 9)]
    + [(1, k) for k in (4, 5, 6, 7, 8, 9)]
    + [(2, k) for k in (5, 6, 7, 8, 9)]
    + [(3, k) for k in (6, 7, 8, 9)]
    + [(4, k) for k in (7, 8, 9)]
)
"""Links that can meet; neighbours along the arm always touch and are left out."""

_FRAME_OF_LINK = np.array([0, 1, 2, 2, 3, 3, 4, 5, 6, 6])

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_GOLDEN_ROUNDS = 16
"""Leaves 5e-4 of a link's length."""


@dataclass(frozen=True, slots=True)
class _Size:
    """Sideways offsets of the two long links from the arm's plane, and radii, in metres."""

    shoulder_offset: float
    elbow_offset: float
    upper_radius: float
    fore_radius: float
    wrist_radius: float


_SMALL = _Size(0.120, 0.027, 0.055, 0.045, 0.040)
_MEDIUM = _Size(0.138, 0.007, 0.065, 0.050, 0.045)
_LARGE = _Size(0.1762, 0.0393, 0.075, 0.060, 0.055)
_SLIM = _Size(0.193, 0.071, 0.080, 0.065, 0.055)
_HEAVY = _Size(0.260, 0.043, 0.095, 0.075, 0.065)
_SIZES = {
    "ur3e": _SMALL,
    "ur5e": _MEDIUM,
    "ur7e": _MEDIUM,
    "ur10e": _LARGE,
    "ur12e": _LARGE,
    "ur16e": _LARGE,
    "ur15": _SLIM,
    "ur20": _HEAVY,
    "ur30": _HEAVY,
}


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """The tool as two capsules on the line from the flange to its tip: what carries the plug, and the plug."""

    tip: tuple[float, float, float]
    """In the flange frame, m; usually the TCP."""
    radius: float = 0.05
    plug_length: float = 0.0
    """What is in front of the wider part; 0: nothing."""
    plug_radius: float = 0.035

    @property
    def ends(self) -> tuple[Array, Array]:
        """Where the axes of the wider part and of the plug end, (3,) each in the flange frame."""
        tip = np.asarray(self.tip, dtype=np.float64)
        length = float(np.linalg.norm(tip))
        if self.plug_length <= 0.0 or length == 0.0:
            return tip, tip
        return tip * max(0.0, 1.0 - (self.plug_length + self.radius) / length), tip


@dataclass(frozen=True, slots=True)
class Clearance:
    """The smallest distance along a path; negative where bodies overlap."""

    distance_m: float
    what: str
    """The two bodies, such as ``forearm and cover``."""
    sample: int
    """At which of the poses."""


NO_NEARER_M = 0.001


def clearance(model: ArmModel, joints: Array, tool: Tool, boxes: tuple[Box, ...] = ()) -> Clearance:
    """Smallest distance of the arm from itself and from ``boxes`` over joint vectors (K, 6)."""
    return min((_smallest(*pairs) for pairs in _gaps(model, joints, tool, boxes)), key=lambda one: one.distance_m)


def intrusion(model: ArmModel, joints: Array, tool: Tool, boxes: tuple[Box, ...], least_m: float) -> Clearance | None:
    """The worst of what comes nearer than ``least_m`` along joint vectors (K, 6), or None.

    Two bodies that are too near at the first of them already may stay so, but come no nearer.
    """
    found = []
    for gaps, names in _gaps(model, joints, tool, boxes):
        worst = gaps.min(axis=0)
        bad = (worst < least_m) & (worst < gaps[0] - NO_NEARER_M)
        if bad.any():
            found.append(_smallest(gaps[:, bad], [name for name, is_bad in zip(names, bad, strict=True) if is_bad]))
    return min(found, key=lambda one: one.distance_m, default=None)


def _gaps(model: ArmModel, joints: Array, tool: Tool, boxes: tuple[Box, ...]) -> list[tuple[Array, list[str]]]:
    """Distances (K, P) of pairs of bodies along a path, and the pairs' names: the arm's own, then each box's."""
    starts, ends, radii = _capsules(model, np.asarray(joints, dtype=np.float64), tool)
    return [_self_gaps(starts, ends, radii), *(_box_gaps(starts, ends, radii, box) for box in boxes)]


def _smallest(gaps: Array, names: list[str]) -> Clearance:
    sample, pair = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    return Clearance(float(gaps[sample, pair]), names[pair], int(sample))


def _capsules(model: ArmModel, joints: Array, tool: Tool) -> tuple[Array, Array, Array]:
    """Axes of all links in the base frame: starts and ends (K, 10, 3), and radii (10,)."""
    size = _SIZES[model.name]
    so, eo = size.shoulder_offset, size.elbow_offset
    body, plug = tool.ends
    local = np.array(
        [
            [(0, 0, 0), (0, 0, model.d1)],
            [(0, 0, 0), (0, 0, so)],
            [(0, 0, so), (-model.a2, 0, so)],
            [(0, 0, so), (0, 0, eo)],
            [(0, 0, eo), (-model.a3, 0, eo)],
            [(0, 0, eo), (0, 0, model.d4)],
            [(0, 0, 0), (0, 0, model.d5)],
            [(0, 0, 0), (0, 0, model.d6)],
            [(0, 0, 0), body],
            [body, plug],
        ],
        dtype=np.float64,
    )
    u, f, w = size.upper_radius, size.fore_radius, size.wrist_radius
    front = tool.plug_radius if tool.plug_length > 0.0 else tool.radius
    radii = np.array([u, u, u, f, f, w, w, w, tool.radius, front])
    frames = frames_many(model, joints)[:, _FRAME_OF_LINK]
    ends = np.einsum("klij,lej->klei", frames[..., :3, :3], local) + frames[..., None, :3, 3]
    return ends[:, :, 0], ends[:, :, 1], radii


def _self_gaps(starts: Array, ends: Array, radii: Array) -> tuple[Array, list[str]]:
    a, b = _SELF_PAIRS.T
    distance = segment_distance(starts[:, a], ends[:, a], starts[:, b], ends[:, b]) - radii[a] - radii[b]
    return distance, [f"{LINKS[i]} and {LINKS[j]}" for i, j in _SELF_PAIRS]


def _box_gaps(starts: Array, ends: Array, radii: Array, box: Box) -> tuple[Array, list[str]]:
    """The base stands where it stands: links from the shoulder on are looked at."""
    links = np.arange(1, TOOL if box.tool_may_touch else len(LINKS))
    inverse = box.T_base_box.inverse()
    start, end = (inverse.apply(points[:, links].reshape(-1, 3)) for points in (starts, ends))
    gaps = segment_box_distance(start, end, np.asarray(box.half_size)).reshape(-1, len(links)) - radii[links]
    return gaps, [f"{LINKS[link]} and {box.name}" for link in links]


def segment_distance(p1: Array, q1: Array, p2: Array, q2: Array) -> Array:
    """Distance between segments p1-q1 and p2-q2, arrays (..., 3), by the closest points of the clamped lines."""
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a, e, f = (d1 * d1).sum(-1), (d2 * d2).sum(-1), (d2 * r).sum(-1)
    c, b = (d1 * r).sum(-1), (d1 * d2).sum(-1)
    tiny = 1e-12
    denominator = a * e - b * b
    s = np.where(denominator > tiny, np.clip((b * f - c * e) / np.maximum(denominator, tiny), 0, 1), 0.0)
    t = np.clip((b * s + f) / np.maximum(e, tiny), 0, 1)
    s = np.clip((b * t - c) / np.maximum(a, tiny), 0, 1)
    t = np.clip((b * s + f) / np.maximum(e, tiny), 0, 1)
    return np.asarray(np.linalg.norm(r + d1 * s[..., None] - d2 * t[..., None], axis=-1))


def segment_box_distance(start: Array, end: Array, half_size: Array) -> Array:
    """Distance of segments (N, 3) from a box at the origin; 0 inside. Convex along a segment: golden section."""

    def at(share: Array) -> Array:
        point = start + share[:, None] * (end - start)
        return np.asarray(np.linalg.norm(np.maximum(np.abs(point) - half_size, 0.0), axis=1))

    low, high = np.zeros(len(start)), np.ones(len(start))
    for _ in range(_GOLDEN_ROUNDS):
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        nearer_left = at(left) < at(right)
        low, high = np.where(nearer_left, low, left), np.where(nearer_left, right, high)
    return at((low + high) / 2)
