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
from perception.gate import roll_of
from perception.geometry import Array, Pose
from perception.port_model import PortModel

COARSE_M = 0.0025
"""Spacing of the clouds that global methods work on."""
_NEAR_M = 0.0015
_ALIGNED = 3
_COARSE_GATES_M = (0.005, 0.0025)
_GATES_M = (0.0015, 0.0007)
_ITERATIONS = 20
_SLACK_M, _SLACK_RAD = 0.006, float(np.deg2rad(4.0))
_registration: Any = o3d.pipelines.registration


@dataclass(frozen=True, eq=False)
class PeerProblem:
    """A prepared scan in the prior's frame and the samples of the CAD in the port's frame, both with normals."""

    scan: Any
    """Open3D cloud."""
    model: PortModel
    prior: Prior

    @cached_property
    def samples(self) -> Any:
        """Open3D cloud of what can be seen of the CAD."""
        return _cloud(self.model.surface.points, self.model.surface.normals)

    @cached_property
    def coarse_scan(self) -> Any:
        """The scan at ``COARSE_M``."""
        return self.scan.voxel_down_sample(COARSE_M)

    @cached_property
    def coarse_samples(self) -> Any:
        """The CAD's samples at ``COARSE_M``."""
        return self.samples.voxel_down_sample(COARSE_M)

    @cached_property
    def tree(self) -> cKDTree:
        """Of the coarse scan's points."""
        return cKDTree(np.asarray(self.coarse_scan.points))


def best(problem: PeerProblem, poses: Iterable[Pose]) -> Pose:
    """The finely aligned pose of those (T_prior_port) that the prior allows and that explain most of the CAD.

    Without any that it allows: where the prior expects the port.
    """
    allowed = [pose for pose in poses if within_prior(pose, problem.prior)] or [Pose.identity()]
    ranked = sorted(allowed, key=lambda pose: -explained(problem, pose))[:_ALIGNED]
    aligned = [_icp(problem.coarse_scan, problem, pose, _COARSE_GATES_M) for pose in ranked]
    pose = max(aligned, key=lambda pose: explained(problem, pose))
    return _icp(_around(problem, pose), problem, pose, _GATES_M)


def _around(problem: PeerProblem, pose: Pose) -> Any:
    """The scan's points near the CAD at a pose: only these can be paired, the others cost time."""
    placed = o3d.geometry.PointCloud(problem.samples).transform(pose.matrix)
    distance = np.asarray(problem.scan.compute_point_cloud_distance(placed))
    return problem.scan.select_by_index(np.flatnonzero(distance < 2 * _GATES_M[0]))


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


def _icp(scan: Any, problem: PeerProblem, pose: Pose, gates_m: tuple[float, ...]) -> Pose:
    """Point-to-plane ICP of the scan against the CAD with Tukey's weights and shrinking gates."""
    T_port_prior = pose.inverse().matrix
    for gate in gates_m:
        estimation = _registration.TransformationEstimationPointToPlane(_registration.TukeyLoss(gate))
        criteria = _registration.ICPConvergenceCriteria(max_iteration=_ITERATIONS)
        found = _registration.registration_icp(scan, problem.samples, gate, T_port_prior, estimation, criteria)
        T_port_prior = np.asarray(found.transformation)
    return rigid(T_port_prior).inverse()


def rigid(matrix: Array) -> Pose:
    """The nearest rigid transform to a 4x4 matrix: single precision leaves rotations a little off."""
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    return Pose(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt, np.array(matrix[:3, 3]))


def _cloud(points: Array, normals: Array) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud
