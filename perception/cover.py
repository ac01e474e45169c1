"""The open charging cover beside a located port: on which side it is hinged, its plane, and a box to keep clear of.

A flap stands proud of the panel, is flat, and its plane meets the panel in a line beside the pocket: the hinge. What a
scan shows of it ends where the sensor's range does, so the box reaches as far from the hinge as flaps do. Things in
front of the inlet that are not such a plane (cables, hands) are not covers and are left to the evidence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import small_gicp
from numpy.typing import NDArray

from perception.estimate import PortEstimate
from perception.geometry import Array, Pose
from perception.scan import Cloud

Side = Literal["left", "right", "top", "bottom"]
"""Seen by someone who looks into the port."""

_VOXEL_M = 0.003
_REACH_M = 0.26
"""How far from the port's axis a cover is looked for."""
_PANEL_M = (-0.004, 0.06)
"""The panel's height over the rim plane lies within this."""
_INLET_M = 0.07
"""No inlet reaches farther from its origin."""
_PANEL_CELLS = 300
"""Of the thinned scan, some 27 cm2: so much of the panel is seen, or what stands proud of it cannot be told."""
_PROUD_M = 0.009
_THICK_M = 0.0025
"""Points within this of a plane belong to it."""
_PLANES = 6
"""Flat things that are looked at, the largest first."""
_POCKET_M = 0.045
"""No pocket ends nearer to the port's axis."""
_SKIN_SLOPE = 0.2
"""Less than the flattest flap's that counts as open."""
_SIDE_CELLS = 15
_SHELF_CELLS, _HEIGHT_STEP_M = 150, 0.003
"""So much at heights within two steps is something wide."""
_TRIALS = 400
_MIN_POINTS = 60
_MIN_SPAN_M, _MIN_SEEN_M = 0.045, 0.02
"""Narrower or lower things are trims and clutter."""
_HINGE_M = (0.025, 0.15)
"""Distance of the hinge from the port's origin."""
_OPENING_RAD = (1.25, 2.92)
"""One that is turned back farther lies on the panel, out of the way."""
_FLAP_M = 0.17
_PAD_M = 0.006
_BEHIND_M = (0.007, 0.022)
"""Farther behind its front than a flap is thick."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenCover:
    """A flap, in the estimate's frame."""

    side: Side
    """Where its hinge is."""
    opening_rad: float
    """By how much it is turned open: pi/2 stands straight out of the vehicle."""
    T_ref_box: Pose
    """Centre of the box around it: x along the hinge, y away from the hinge, z along the flap's normal."""
    half_size_m: tuple[float, float, float]
    seen_m: float
    """How far from the hinge the scan shows it; the box reaches farther."""
    points: int
    """Cells of the thinned scan that lie on it."""

    @property
    def corners(self) -> Array:
        """(8, 3) corners of the box."""
        signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), axis=-1).reshape(8, 3)
        return self.T_ref_box.apply(signs * np.asarray(self.half_size_m))


def find_cover(cloud: Cloud, estimate: PortEstimate) -> OpenCover | None:
    """The open cover that a scan shows around a located port; None where it shows none.

    :param cloud: the scan, in the estimate's frame (``estimate.ref``).
    """
    local = estimate.T_ref_port.inverse().apply(cloud.points)
    near = (np.hypot(local[:, 0], local[:, 1]) < _REACH_M) & (local[:, 2] > _PANEL_M[0]) & (local[:, 2] < _REACH_M)
    if near.sum() < _MIN_POINTS:
        return None
    thin = np.asarray(small_gicp.voxelgrid_sampling(local[near], _VOXEL_M, 1).points())[:, :3]
    if not _panel_is_seen(thin):
        return None
    rng = np.random.default_rng(0)  # the same scan gives the same answer
    level, everything = _panel_level(thin), _without_strays(thin[thin[:, 2] - _panel_height(thin) > _PROUD_M])
    proud = at_first = everything
    found = list[OpenCover]()
    for _ in range(_PLANES):
        if len(proud) < _MIN_POINTS:
            break
        plane, on_plane = _plane(proud, rng)
        if _is_skin(plane, proud[on_plane]):  # what lay below was the pocket: begin anew above this
            level, found = plane[3] / plane[2], []
            proud = everything = _without_strays(thin[(thin @ plane[:3] - plane[3]) / plane[2] > _PROUD_M])
            continue
        cover = _as_cover(plane, proud[on_plane], everything, level, estimate.T_ref_port)
        others = at_first[np.abs(at_first @ plane[:3] - plane[3]) > _THICK_M]
        found += [] if cover is None or _ends_at_skin(proud[on_plane], others) else [cover]
        proud = proud[~on_plane]
    # Two at different sides are walls of the pocket that the inlet lies in.
    return found[0] if len({cover.side for cover in found}) == 1 else None


def _ends_at_skin(points: Array, others: Array) -> bool:
    """Whether a plane's points (N, 3) end at the height of something wide: a wall that leads up to the skin.

    Of the skin around a pocket an askew scan may show no more than curved strips at one or two sides.

    :param others: (M, 3) what else stands proud of the lowest level.
    """
    counts, edges = np.histogram(others[:, 2], np.arange(_PANEL_M[0], _REACH_M, _HEIGHT_STEP_M))
    wide = edges[1:-1][counts[:-1] + counts[1:] >= _SHELF_CELLS]
    return bool((np.abs(np.quantile(points[:, 2], 0.95) - wide) < _PROUD_M).any())


def _is_skin(plane: Array, points: Array) -> bool:
    """Whether a plane is the vehicle's skin around the pocket: hardly tilted, large, and on three sides of the port."""
    x, y = points[:, 0], points[:, 1]
    outside = np.hypot(x, y) > _POCKET_M
    if np.hypot(plane[0], plane[1]) > _SKIN_SLOPE * abs(plane[2]) or outside.sum() < _PANEL_CELLS:
        return False
    wide, far = np.abs(x) >= np.abs(y), outside
    sides = [far & wide & (x > 0), far & wide & (x < 0), far & ~wide & (y > 0), far & ~wide & (y < 0)]
    return sum(int(side.sum()) >= _SIDE_CELLS for side in sides) >= 3


def _panel_is_seen(points: Array) -> bool:
    """Whether the level is the panel's, seen beyond the inlet. A narrow scan ends within the pocket: its level is the
    inlet's own face, and the pocket's wall would pass for a flap."""
    beyond = np.hypot(points[:, 0], points[:, 1]) > _INLET_M
    return int((beyond & (np.abs(points[:, 2] - _panel_level(points)) < 0.005)).sum()) >= _PANEL_CELLS


def _panel_level(points: Array) -> float:
    """Height of the panel over the rim plane: the height at which most points lie."""
    heights = points[(points[:, 2] > _PANEL_M[0]) & (points[:, 2] < _PANEL_M[1]), 2]
    counts, edges = np.histogram(heights, np.arange(_PANEL_M[0], _PANEL_M[1] + 0.003, 0.003))
    at = int(np.argmax(counts))
    return float((edges[at] + edges[at + 1]) / 2)


def _panel_height(points: Array) -> Array:
    """(N,) height of the panel at each point's place: a slightly curved sheet through the panel's points."""
    level = _panel_level(points)
    x, y = points[:, 0], points[:, 1]
    terms = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    height = np.full(len(points), level)
    for gate in (0.008, 0.005):
        on_panel = np.abs(points[:, 2] - height) < gate
        if on_panel.sum() < 50:
            break
        height = terms @ np.linalg.lstsq(terms[on_panel], points[on_panel, 2], rcond=None)[0]
    bounded: Array = np.clip(height, level - 0.02, level + 0.02)
    return bounded


def _without_strays(points: Array) -> Array:
    """Points with at least a few others around them: a flap has, flying points have not."""
    if len(points) < _MIN_POINTS:
        return points
    cell = np.unique(np.floor(points / 0.009).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)
    kept: Array = points[np.bincount(cell)[cell] >= 4]
    return kept


def _plane(points: Array, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """The plane (normal, offset) (4,) through most points, and which points lie on it."""
    triples = points[rng.integers(len(points), size=(_TRIALS, 3))]
    normal = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normal, axis=1)
    normal = normal[length > 1e-7] / length[length > 1e-7, None]
    offset = np.einsum("ij,ij->i", normal, triples[length > 1e-7, 0])
    counts = (np.abs(points @ normal.T - offset) < _THICK_M).sum(axis=0)
    best = int(np.argmax(counts))
    on_plane = np.abs(points @ normal[best] - offset[best]) < _THICK_M
    for _ in range(2):  # least squares on what lies on it
        middle = points[on_plane].mean(axis=0)
        n = np.linalg.svd(points[on_plane] - middle, full_matrices=False)[2][2]
        on_plane = np.abs((points - middle) @ n) < _THICK_M
    return np.append(n, n @ middle), on_plane


def _as_cover(plane: Array, points: Array, proud: Array, panel_m: float, T_ref_port: Pose) -> OpenCover | None:
    """The cover that a plane is, if it can be one: hinged beside the inlet, opened by a likely angle, large enough.

    :param points: (N, 3) on the plane. :param proud: (M, 3) all that stands proud of the panel.
    """
    slope = float(np.hypot(plane[0], plane[1]))
    if len(points) < _MIN_POINTS or slope < 0.08:
        return None
    outward = plane[:2] / slope
    distance = (plane[3] - plane[2] * panel_m) / slope
    if distance < 0:
        outward, distance = -outward, -distance
    hinge = np.array([-outward[1], outward[0], 0.0])
    away = np.cross(plane[:3], hinge)
    away = away / np.linalg.norm(away) * np.sign(away[2])  # from the hinge along the flap, out of the vehicle
    origin = np.array([*(distance * outward), panel_m])
    opening = float(np.pi - np.arctan2(away[2], away[:2] @ outward))
    along, up = (points - origin) @ hinge, (points - origin) @ away
    span, seen = np.quantile(along, [0.01, 0.99]), float(np.quantile(up, 0.99))
    likely = _HINGE_M[0] < distance < _HINGE_M[1] and _OPENING_RAD[0] < opening < _OPENING_RAD[1]
    if not likely or span[1] - span[0] < _MIN_SPAN_M or seen < _MIN_SEEN_M or up.min() < -0.02:
        return None
    if _has_top(proud - origin, np.stack([hinge, away, np.append(outward, 0.0)]), span, seen):
        return None
    reach = max(seen, _FLAP_M)
    half = ((span[1] - span[0]) / 2 + _PAD_M, reach / 2 + _PAD_M, _PAD_M)
    centre = origin + hinge * span.mean() + away * reach / 2
    box = Pose(np.column_stack([hinge, away, np.cross(hinge, away)]), centre)
    return OpenCover(_side(outward), opening, T_ref_port @ box, half, seen, len(points))


def _has_top(offset: Array, axes: Array, span: Array, seen: float) -> bool:
    """Whether the plane ends in a face that leads away from the inlet: the wall of a trim or bumper, no flap.

    :param offset: (N, 3) points seen from the hinge's middle.
    :param axes: rows: along the hinge, away from it in the plane, sideways from the inlet.
    """
    along, up, aside = (offset @ axis for axis in axes)
    flap_aside = up * (axes[1] @ axes[2])  # the plane itself leans
    behind = (aside - flap_aside > _BEHIND_M[0]) & (aside - flap_aside < _BEHIND_M[1])
    top = behind & (np.abs(up - seen) < 0.008) & (along > span[0]) & (along < span[1])
    covered = len(np.unique(np.floor(along[top] / 0.006)))
    return bool(covered * 0.006 > 0.35 * (span[1] - span[0]))


def _side(outward: Array) -> Side:
    x, y = outward
    if abs(x) >= abs(y):
        return "right" if x > 0 else "left"
    return "top" if y > 0 else "bottom"
