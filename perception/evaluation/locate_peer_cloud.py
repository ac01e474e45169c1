"""What every peer is given and what is done with every peer's answers: the clouds, the choice, the fine alignment."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

from perception.estimate import Prior
from perception.evaluation.locate_peer_cad import PeerCad, peer_cad
from perception.gate import roll_of
from perception.geometry import Array, Pose
from perception.port_model import PortModel

COARSE_M = 0.0025
"""Spacing of the clouds that a pose is judged and first aligned on."""
_LONELY_M, _LONELY = 0.003, 12
"""Fewer points than this within the radius, of 28 on a whole surface: outliers and mixed pixels that the preparation
left. Features with such points among their neighbours match nothing."""
_NEAR_M = 0.0015
_ALIGNED = 4
_SAME_M, _SAME_RAD = 0.003, float(np.deg2rad(5.0))
_COARSE_GATES_M = ((0.005, 0.0025), (0.010, 0.005, 0.0025))
"""Both ways from every answer: the wider gates reach the port from farther off and pull others off it."""
_GATES_M = (0.0015, 0.0007)
_AGREE_M, _AGREE_COSINE = 0.003, float(np.cos(np.deg2rad(30.0)))
_ITERATIONS = 40
_SLACK_M, _SLACK_RAD = 0.006, float(np.deg2rad(4.0))
_registration: Any = o3d.pipelines.registration


@dataclass(frozen=True, eq=False)
class PeerProblem:
    """A prepared scan in the prior's frame and the samples of the CAD in the port's frame, both with normals."""

    scan: Any
    """Open3D cloud."""
    model: PortModel
    prior: Prior

    @property
    def cad(self) -> PeerCad:
        """Clouds of the CAD, made once for a model."""
        return peer_cad(self.model)

    @cached_property
    def clean(self) -> Any:
        """The scan without points that stand nearly alone."""
        return self.scan.remove_radius_outlier(_LONELY, _LONELY_M)[0]

    @cached_property
    def coarse_scan(self) -> Any:
        """The clean scan at ``COARSE_M``."""
        return self.clean.voxel_down_sample(COARSE_M)

    @cached_property
    def coarse_samples(self) -> Any:
        """What a scan shows of the CAD, at ``COARSE_M``."""
        return self.cad.seen.voxel_down_sample(COARSE_M)

    @cached_property
    def tree(self) -> cKDTree:
        """Of the coarse scan's points."""
        return cKDTree(np.asarray(self.coarse_scan.points))


def best(problem: PeerProblem, poses: Iterable[Pose]) -> Pose:
    """The finely aligned pose of those (T_prior_port) that the prior allows and that explain most of the CAD.

    Without any that it allows: where the prior expects the port.
    """
    allowed = [pose for pose in poses if within_prior(pose, problem.prior)] or [Pose.identity()]
    ranked = _distinct(sorted(allowed, key=lambda pose: -explained(problem, pose)))[:_ALIGNED]
    aligned = [
        _icp(problem.coarse_scan, problem.cad.thinned, pose, gates) for pose in ranked for gates in _COARSE_GATES_M
    ]
    # What a global method found right is not given up for a place beyond the prior that alignment slid to.
    kept = [pose for pose in aligned if within_prior(pose, problem.prior)] or ranked
    pose = max(kept, key=lambda pose: explained(problem, pose))
    return _icp(_agreeing(problem, pose), problem.cad.samples, pose, _GATES_M)


def _distinct(poses: Iterable[Pose]) -> list[Pose]:
    """Without poses near an earlier one, which alignment would bring to the same place."""
    taken: list[Pose] = []
    for pose in poses:
        if all(pose.distance_to(other) > _SAME_M or pose.angle_to(other) > _SAME_RAD for other in taken):
            taken.append(pose)
    return taken


def _agreeing(problem: PeerProblem, pose: Pose) -> Any:
    """The scan's points near a sample of the CAD that faces as they do, at a pose.

    The others cost time, and mixed pixels beside an edge turn a port that is nearly round.
    """
    back = pose.inverse()
    distance, index = problem.cad.tree.query(
        back.apply(np.asarray(problem.scan.points)), distance_upper_bound=_AGREE_M, workers=1
    )
    near = np.flatnonzero(np.isfinite(distance))
    facing = back.rotate(np.asarray(problem.scan.normals)[near])
    cosine = (facing * np.asarray(problem.cad.samples.normals)[index[near]]).sum(axis=1)
    return problem.scan.select_by_index(near[cosine > _AGREE_COSINE])


def within_prior(pose: Pose, prior: Prior) -> bool:
    """Whether T_prior_port is a pose that the prior allows, with a little slack."""
    tilt = float(np.arccos(np.clip(pose.rotation[2, 2], -1.0, 1.0)))
    return bool(
        np.hypot(*pose.translation[:2]) < prior.lateral_m + _SLACK_M
        and abs(pose.translation[2]) < prior.along_m + _SLACK_M
        and tilt < prior.tilt_rad + _SLACK_RAD
        and abs(roll_of(pose)) < prior.roll_rad + _SLACK_RAD
    )


def explained(problem: PeerProblem, pose: Pose) -> float:
    """Share of the CAD's samples that have a scan point near."""
    points = pose.apply(np.asarray(problem.coarse_samples.points))
    found = problem.tree.query(points, distance_upper_bound=_NEAR_M)[0]
    return float(np.isfinite(found).mean())


def _icp(scan: Any, samples: Any, pose: Pose, gates_m: tuple[float, ...]) -> Pose:
    """Point-to-plane ICP of the scan against the CAD with Tukey's weights and shrinking gates."""
    T_port_prior = pose.inverse().matrix
    for gate in gates_m:
        estimation = _registration.TransformationEstimationPointToPlane(_registration.TukeyLoss(gate))
        criteria = _registration.ICPConvergenceCriteria(1e-7, 1e-7, _ITERATIONS)
        found = _registration.registration_icp(scan, samples, gate, T_port_prior, estimation, criteria)
        T_port_prior = np.asarray(found.transformation)
    return rigid(T_port_prior).inverse()


def rigid(matrix: Array) -> Pose:
    """The nearest rigid transform to a 4x4 matrix: single precision leaves rotations a little off."""
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    return Pose(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt, np.array(matrix[:3, 3]))
