"""Final pose: iteratively reweighted point-to-plane registration of every point near the port against the CAD.

The gate starts wide and closes to a multiple of the scan's own noise; it may not close at once, since a pose half a
millimetre off sideways sees its few wall points as outliers among the many on flats that fit already.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perception.crop import Scene
from perception.depths import depth_dispute
from perception.distortion import UNDISTORTED, Distortion, distortion
from perception.edges import edge_rows
from perception.errors import DegenerateCloudError
from perception.geometry import Array, Pose
from perception.matching import Matches, Measured, match, measure
from perception.nuisance import Rows, columns
from perception.port_model import PortModel
from perception.sideways import settle_sideways

ROUNDS = 10
FULL_ROUNDS = 4
_SUBSET = 4000
_MIN_SCALE_M = 0.00003
_TUKEY = 4.0
"""Points further off than this many robust standard deviations have no weight."""
_FIRST_GATE_M = 0.0015
_FIRST_SCALE_M = 0.0002
"""Noise taken for granted before the scan's own is known."""
_GATE_SHRINK = 0.6
_EDGE_SIGMAS = 2.5
"""A point nearer to an edge than this many standard deviations may belong to either side."""
_EDGE_NOISE_M = 0.0001
"""Standard deviation of where an edge seems to be: the scan's spacing, the part's roundings, vibration."""
_WALL_SHARE = (0.4, 1.1)
"""Least and greatest noise of a wall's points, as a share of the noise on flats."""
_EDGE_GATE_M = 0.0004
"""A point further than this on the wrong side of an edge is something else."""
_EDGE_LEAST_M = 0.00002
"""Below this the least-absolute weights stop growing."""
_DISPUTE_RAD = float(np.deg2rad(0.4))
"""Walls and edges that differ by more about the roll are fitted once more, from where the edges have it."""
_EDGES_M = 0.00003
"""All edges together fix the port sideways no better than this: what makes an edge look displaced is common to many."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The final pose and the equations that gave it."""

    T_prior_port: Pose
    jacobian: Array
    """(N, 6 + K): the distances by a motion in the port frame (translation m, rotation vector rad) and by nuisances."""
    distance: Array
    """(N,) residuals, metres: signed distances to the surface, then to edges."""
    weight: Array
    """(N,) weights of the equations, 1/m2."""
    precision: Array
    """(6 + K,) prior information of each parameter; 0 for the pose."""
    local: Array
    """(N, 3) the used points in the port frame."""
    planes: int
    """How many of the equations, the first ones, are distances to surfaces."""
    beyond: NDArray[np.int64]
    """(N - planes,) which of the matched points the equations for edges belong to."""
    scale_m: float
    """Robust standard deviation of the distances to surfaces."""
    sweep: Array
    """(3,) unit vector of the scanner's sweep, port frame."""
    roll_dispute_rad: float = 0.0
    """How far from this roll the port's edges alone would have it."""
    distortion: Distortion = UNDISTORTED
    """Of the scan around this pose."""
    depth_dispute_m: float = 0.0
    """How much higher than the model has it the flat that disagrees most is seen."""

    @property
    def rms_m(self) -> float:
        """Weighted root mean square distance to the surface."""
        w, d = self.weight[: self.planes], self.distance[: self.planes]
        return float(np.sqrt((w * d**2).sum() / max(w.sum(), 1e-12)))

    @property
    def information(self) -> Array:
        """(6 + K, 6 + K) normal matrix with the priors."""
        scaled = self.jacobian * np.sqrt(self.weight)[:, None]
        return np.asarray(scaled.T @ scaled + np.diag(self.precision))


def refine(start: Pose, scene: Scene, model: PortModel, *, threads: int = 2) -> Refined:
    """Refines ``start`` (T_prior_port). Raises DegenerateCloudError when the points near it do not fix a pose.

    Walls can pull the roll away from where the edges have it: then the last rounds are done again from there.
    """
    near = model.nearest.lookup(start.inverse().apply(scene.points)) < model.nearest.none
    if int(near.sum()) < 50:
        raise DegenerateCloudError("hardly any scan point lies near the port's surface")
    everything = measure(scene.points[near], scene.origins[near], threads)
    some = everything.every(max(1, len(everything.points) // _SUBSET))
    fit = _Fit(scene, model, threads)
    pose, scale = settle_sideways(start, everything, model, _FIRST_SCALE_M), 0.0005
    last = range(ROUNDS - FULL_ROUNDS, ROUNDS)
    for round_ in range(last.start):
        matches = match(pose, some, model, threads)
        scale = _robust_scale(matches.distance, previous=scale)
        try:
            pose = _moved(pose, _step(_equations(pose, matches, model, scale, _gate(round_))))
        except DegenerateCloudError:
            break  # so few points may leave the roll open where all of them do not
    pose = settle_sideways(pose, everything, model, scale, first=2)
    final = fit.rounds(pose, everything, scale, last)
    settled = settle_sideways(final.T_prior_port, everything, model, final.scale_m, first=1)
    if settled.angle_to(final.T_prior_port) > _DISPUTE_RAD:
        with suppress(DegenerateCloudError):  # the dispute then speaks against the pose that there is
            final = fit.rounds(settled, everything, final.scale_m, last)
            settled = settle_sideways(final.T_prior_port, everything, model, final.scale_m, first=1)
    pose, scale = final.T_prior_port, final.scale_m
    return replace(
        final,
        roll_dispute_rad=settled.angle_to(pose),
        distortion=distortion(pose, everything, model, scale),
        depth_dispute_m=depth_dispute(pose, everything, model.flats, scale),
    )


def _gate(round_: int) -> float:
    return _FIRST_GATE_M * _GATE_SHRINK**round_


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """The last rounds, with every point and with nuisances."""

    scene: Scene
    model: PortModel
    threads: int

    def rounds(self, pose: Pose, measured: Measured, scale: float, which: range) -> Refined:
        """Moves ``pose`` by one step for each of the rounds ``which``. Raises DegenerateCloudError in the first.

        An edge tells only while points contradict it: rounds that leave nothing to correct end with the one before.
        """
        final: Refined | None = None
        for round_ in which:
            matches = match(pose, measured, self.model, self.threads)
            if not len(matches.kept):
                raise DegenerateCloudError("no scan point near the port faces as its surface does")
            scale = _robust_scale(matches.distance, previous=scale)
            equations = _equations(pose, matches, self.model, scale, _gate(round_))
            equations = _with_nuisance(equations, matches, measured, self.scene, self.model)
            try:
                pose = _moved(pose, _step(equations))
            except DegenerateCloudError:
                if final is None:
                    raise
                return final
            final = replace(equations, T_prior_port=pose)
        assert final is not None  # ``which`` has a round
        return final


def _robust_scale(distance: Array, previous: float) -> float:
    """Standard deviation from the median absolute distance of the points within reach of the previous scale."""
    close = np.abs(distance[np.abs(distance) < 5 * previous])
    if len(close) < 30:
        return previous
    # Not faster than a third for each round: a gate that closes at once traps the pose where it happens to be.
    return float(np.clip(1.4826 * np.median(close), max(_MIN_SCALE_M, 0.67 * previous), previous))


def _wall_scale(matches: Matches, scale: float) -> float:
    """Standard deviation of the distances to walls, as the scan itself shows it.

    Noise along the ray would leave a grazed wall measured better than a flat, but not every scanner's noise acts so; a
    gate too narrow for it throws good points away with the mixed pixels.
    """
    away = np.abs(matches.distance[np.abs(matches.normal[:, 2]) < 0.5])
    away = away[away < 5 * scale]
    least, most = _WALL_SHARE
    seen = 1.4826 * float(np.median(away)) if len(away) >= 30 else scale
    return float(np.clip(seen, least * scale, most * scale))


def _equations(pose: Pose, matches: Matches, model: PortModel, scale: float, gate: float) -> Refined:
    """One row for each point's distance to its surface, and one for each point or ray on the wrong side of an edge."""
    taper = np.clip(model.surface.edge_m[matches.index] / (_EDGE_SIGMAS * scale) - 0.5, 0.0, 1.0)
    wall = 1.0 - np.abs(matches.normal[:, 2])
    sigma = np.sqrt(scale**2 * (1.0 - wall) + _wall_scale(matches, scale) ** 2 * wall)
    weight = _tukey(matches.distance / sigma, max(_TUKEY, gate / scale)) * taper / sigma**2
    weight *= model.decides[matches.index]
    edges = edge_rows(matches, model, scale)
    # Least absolute, not least squares: a few false points far beyond an edge must not outvote many just beyond it.
    edge_weight = _tukey(edges.beyond, max(_EDGE_GATE_M, gate))
    edge_weight /= _EDGE_NOISE_M * np.maximum(np.abs(edges.beyond), _EDGE_LEAST_M)
    edge_weight *= min(1.0, _EDGES_M**-2 / max(0.5 * float(edge_weight.sum()), 1e-9))
    along, local = np.vstack([matches.normal, edges.outward]), np.vstack([matches.local, edges.local])
    weight = np.concatenate([weight, edge_weight])
    weight *= model.floating.shares(local[:, :2], 1.0 - along[:, 2] ** 2, weight)
    return Refined(
        pose,
        np.hstack([along, np.cross(local, along)]),
        np.concatenate([matches.distance, edges.beyond]),
        weight,
        np.zeros(6),
        local,
        len(matches.local),
        edges.of,
        scale,
        np.zeros(3),
    )


def _with_nuisance(equations: Refined, matches: Matches, measured: Measured, scene: Scene, model: PortModel) -> Refined:
    """The same equations with columns for what part and sweep may do that the model does not say."""
    pose = equations.T_prior_port
    order = np.concatenate([np.arange(equations.planes), equations.beyond])
    sweep = (measured.origins[matches.kept] - scene.sweep_middle) @ scene.sweep_direction
    towards = pose.inverse().apply(np.median(measured.origins, axis=0))
    direction = pose.inverse().rotate(scene.sweep_direction)
    view = towards - (towards @ direction) * direction
    rows = Rows(
        equations.local,
        equations.jacobian[:, :3],
        model.surface.level[matches.index][order].astype(np.int64),
        np.arange(len(order)) >= equations.planes,
        sweep[order],
        direction,
        view / np.linalg.norm(view),
    )
    extra, sigma = columns(rows, int(model.surface.level.max()))
    return replace(
        equations,
        jacobian=np.hstack([equations.jacobian, extra]),
        precision=np.concatenate([equations.precision, sigma**-2]),
        sweep=direction,
    )


def _tukey(residual: Array, gate: float) -> Array:
    u = residual / gate
    return np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0)


def _step(current: Refined) -> Array:
    """The pose's part (6,) of the solution of the normal equations."""
    information = current.information
    scaling = np.concatenate([[1.0] * 3, [1 / 0.03] * 3, np.ones(len(information) - 6)])
    pose_part = (information * np.outer(scaling, scaling))[:6, :6]
    values = np.linalg.eigvalsh(pose_part)
    if values[0] < 1e-6 * max(values[-1], 1e-12):
        raise DegenerateCloudError("the points near the port leave its pose undetermined in at least one direction")
    gradient = -(current.weight * current.distance) @ current.jacobian
    return np.asarray(np.linalg.solve(information, gradient)[:6])


def _moved(pose: Pose, step: Array) -> Pose:
    """``step`` brings the scan onto the model, so the model moves by its inverse."""
    bounded = step.copy()
    bounded[3:] *= min(1.0, 0.05 / max(float(np.linalg.norm(step[3:])), 1e-12))
    return pose @ Pose.from_rotvec(bounded[3:], bounded[:3]).inverse()
