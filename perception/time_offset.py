"""The constant time offset between scanner and arm, from one target swept in both directions.

A profile that is placed ``dt`` too early or too late is displaced along the motion by speed times ``dt``. Swept forth
and back the two clouds are displaced in opposite directions, so the offset at which they coincide is the true one.
Point-to-plane: for a point of the second sweep and the nearest one of the first with its normal ``n``,

    n . (p2 + v2 dt - p1 - v1 dt) = 0,

one unknown, least squares over all pairs, pairs renewed until it settles. Surfaces parallel to the motion say nothing;
their weight, n . (v2 - v1), is zero by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.errors import PortdockError
from perception.geometry import Array, Pose, interpolate
from perception.scan import Profile

MAX_PAIR_M = 0.004
NEIGHBOURS = 12
MAX_POINTS = 20_000
ROUNDS = 30
SETTLED_S = 1e-7
MIN_WEIGHT_M_S = 0.25
"""Of the speed: pairs on surfaces that lean less against the motion than this share are left out."""
MIN_PAIRS = 200


class TimeOffsetError(PortdockError):
    """The two sweeps do not determine a time offset."""

    code = "time-offset"
    default_remedy = "Sweep a target with edges across the motion, the port itself for instance, both ways."


@dataclass(frozen=True, slots=True, eq=False)
class TimedSweep:
    """Profiles with the times at which they are believed to have been measured, and the arm's track in that time."""

    profiles: Sequence[Profile]
    times_s: Array
    """(K,) of the profiles."""
    track_s: Array
    """(N,) growing."""
    track: Sequence[Pose]
    """T_base_flange at ``track_s``."""
    T_flange_scanner: Pose


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """What is to be added to the profiles' times."""

    offset_s: float
    sigma_s: float
    """1 sigma, from the residuals."""
    residual_m: float
    """Between the two clouds once the offset is applied, rms along the normals."""
    pairs: int


def estimate_time_offset(forth: TimedSweep, back: TimedSweep, max_offset_s: float = 0.2) -> TimeOffset:
    """The offset at which both sweeps show the same target. Raises TimeOffsetError."""
    offset_s, found = 0.0, None
    reach_m = MAX_PAIR_M + 2.0 * max_offset_s * _speed(forth)
    for _ in range(ROUNDS):
        found = _step(forth, back, offset_s, reach_m)
        offset_s += found.offset_s
        if abs(offset_s) > max_offset_s:
            raise TimeOffsetError(f"the sweeps do not agree within {max_offset_s * 1e3:.0f} ms")
        reach_m = max(MAX_PAIR_M, 0.5 * reach_m)
        if abs(found.offset_s) < SETTLED_S and reach_m == MAX_PAIR_M:
            break
    assert found is not None
    return TimeOffset(offset_s, found.sigma_s, found.residual_m, found.pairs)


def _step(forth: TimedSweep, back: TimedSweep, offset_s: float, reach_m: float) -> TimeOffset:
    """One linear solve for what is still missing."""
    p1, v1 = _cloud(forth, offset_s)
    p2, v2 = _cloud(back, offset_s)
    tree = cKDTree(p1)
    some = np.linspace(0, len(p2) - 1, min(MAX_POINTS, len(p2))).astype(np.int64)
    distance, nearest = tree.query(p2[some], distance_upper_bound=reach_m)
    paired = np.isfinite(distance)
    some, nearest = some[paired], nearest[paired]
    normals, flat = _normals(p1, tree, nearest)
    weight = np.einsum("ij,ij->i", normals, v2[some] - v1[nearest])
    gap = np.einsum("ij,ij->i", normals, p2[some] - p1[nearest])
    speed = float(np.median(np.linalg.norm(v2, axis=1)))
    use = flat & (np.abs(weight) > MIN_WEIGHT_M_S * 2.0 * speed)
    for _ in range(3):
        if int(use.sum()) < MIN_PAIRS:
            raise TimeOffsetError(f"only {int(use.sum())} pairs of points lean against the motion")
        correction_s = -float(weight[use] @ gap[use] / (weight[use] @ weight[use]))
        residual = gap + weight * correction_s
        scale = 1.4826 * float(np.median(np.abs(residual[use]))) + 1e-9
        use = use & (np.abs(residual) < 3.0 * scale)
    rms_m = float(np.sqrt(np.mean(residual[use] ** 2)))
    sigma_s = rms_m / float(np.sqrt(weight[use] @ weight[use]))
    return TimeOffset(correction_s, sigma_s, rms_m, int(use.sum()))


def _cloud(sweep: TimedSweep, offset_s: float) -> tuple[Array, Array]:
    """Points (N, 3) in the base frame and the velocity (N, 3) that a change of the offset moves each with."""
    step_s = 1e-3
    inside = (sweep.times_s + offset_s - step_s >= sweep.track_s[0]) & (
        sweep.times_s + offset_s + step_s <= sweep.track_s[-1]
    )
    if not inside.any():
        raise TimeOffsetError("the arm's track does not cover the sweep")
    times_s = sweep.times_s[inside] + offset_s
    profiles = [profile for profile, known in zip(sweep.profiles, inside, strict=True) if known]
    here, later = (
        _placed(profiles, interpolate(sweep.track_s, sweep.track, times_s + shift), sweep.T_flange_scanner)
        for shift in (-step_s / 2, step_s / 2)
    )
    return (here + later) / 2.0, (later - here) / step_s


def _placed(profiles: Sequence[Profile], T_base_flange: Sequence[Pose], T_flange_scanner: Pose) -> Array:
    poses = [flange @ T_flange_scanner for flange in T_base_flange]
    parts = [
        pose.apply(np.column_stack([p.points[:, 0], np.zeros(len(p.points)), p.points[:, 1]]))
        for pose, p in zip(poses, profiles, strict=True)
    ]
    return np.concatenate(parts)


def _normals(points: Array, tree: cKDTree, which: NDArray[np.int64]) -> tuple[Array, NDArray[np.bool_]]:
    """Unit normals (M, 3) of the surface at chosen points, and where it is flat enough to have one."""
    _, around = tree.query(points[which], k=NEIGHBOURS)
    spread = points[around] - points[around].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    return vectors[:, :, 0], values[:, 0] < 0.1 * values[:, 1]


def _speed(sweep: TimedSweep) -> float:
    travel = np.linalg.norm(sweep.track[-1].translation - sweep.track[0].translation)
    return float(travel / max(1e-6, sweep.track_s[-1] - sweep.track_s[0]))
