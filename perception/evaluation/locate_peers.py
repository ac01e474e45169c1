"""The tools that users know, through their own libraries: a global registration each, then the same fine alignment.

All get the scan as prepared in ``locate_unit`` (cropped by the prior, thinned, cleaned, normals to the sensor) and the
same clouds of the CAD; those that start from correspondences get the same ones. Those that may answer with any pose are
asked several times, and of their answers the one that the prior allows and that explains most of the CAD is taken: that
helps each of them. Constants are chosen on tuning seeds.
"""

from __future__ import annotations

import importlib
import importlib.util
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import open3d as o3d
import small_gicp

from perception.errors import InputError
from perception.evaluation.locate_cases import CaseScan
from perception.evaluation.locate_peer_cloud import COARSE_M, PeerProblem, best, rigid, within_prior
from perception.evaluation.locate_peer_matches import matches
from perception.evaluation.locate_unit import prepared
from perception.geometry import Array, Pose
from perception.port_model import PortModel

Finder = Callable[[PeerProblem], Pose]
"""From the prepared scan and the CAD to T_prior_port."""

_INLIER_M = 0.003
"""Right answers of features are about this far off."""
_TRIES = 2
_PPF_M, _PPF_STEP = 0.005, 0.04
"""Every pair of the CAD's points is stored: with finer spacing training takes minutes."""
_registration: Any = o3d.pipelines.registration


class PeerMissingError(InputError):
    """The library of a peer is not installed."""

    code: ClassVar[str] = "peer-missing"
    default_remedy: ClassVar[str] = "Install the optional extra: pip install 'portdock[peers]'."


@dataclass(frozen=True, slots=True)
class Peer:
    """A tool to compare with."""

    name: str
    title: str
    library: str
    """Module that must be importable."""
    build: Callable[[], Finder]

    @property
    def present(self) -> bool:
        """Whether its library is installed."""
        try:
            return importlib.util.find_spec(self.library) is not None
        except ModuleNotFoundError:  # the parent of a submodule
            return False

    def load(self) -> Finder:
        """The tool, ready. Raises PeerMissingError."""
        if not self.present:
            raise PeerMissingError(f"peer {self.name} needs the library {self.library}, which is not installed")
        return self.build()


def peer_pose(find: Finder, scan: CaseScan, model: PortModel) -> Pose:
    """T_scanner_port as a peer finds it."""
    return scan.prior.T_ref_port @ find(PeerProblem(prepared(scan, model), model, scan.prior))


def _from_prior(problem: PeerProblem) -> Pose:
    return best(problem, [Pose.identity()])


def _ransac(problem: PeerProblem) -> Pose:
    poses = []
    for found, seed in itertools.product(matches(problem), range(_TRIES)):
        o3d.utility.random.seed(seed)
        answer = _registration.registration_ransac_based_on_correspondence(
            found.source,
            found.target,
            found.as_vector,
            _INLIER_M,
            _registration.TransformationEstimationPointToPoint(False),
            3,
            [
                _registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                _registration.CorrespondenceCheckerBasedOnDistance(_INLIER_M),
                _registration.CorrespondenceCheckerBasedOnNormal(float(np.deg2rad(30.0))),
            ],
            _registration.RANSACConvergenceCriteria(100_000, 0.9999),
        )
        poses.append(rigid(np.asarray(answer.transformation)))
    return best(problem, poses)


def _fgr(problem: PeerProblem) -> Pose:
    poses = []
    for found, scale in itertools.product(matches(problem), (0.9, 0.95, 0.98)):
        o3d.utility.random.seed(0)
        # By default the kernel is not narrowed, so that all pairs count, and distances are shares of the cloud's size.
        option = _registration.FastGlobalRegistrationOption(
            use_absolute_scale=True,
            decrease_mu=True,
            maximum_correspondence_distance=_INLIER_M,
            iteration_number=100,
            tuple_scale=scale,
            maximum_tuple_count=1000,
        )
        answer = _registration.registration_fgr_based_on_correspondence(
            found.source, found.target, found.as_vector, option
        )
        poses.append(rigid(np.asarray(answer.transformation)))
    return best(problem, poses)


def _kiss() -> Finder:
    import kiss_matcher

    def find(problem: PeerProblem) -> Pose:
        poses = []
        # The library's own features take no normals from outside and found fewer ports. Its noise bounds are clamped
        # to 1: with centimetres they stay below.
        for found, voxel_cm in itertools.product(matches(problem), (0.15, 0.2, 0.3, 0.4)):
            matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel_cm))
            answer = matcher.prune_and_solve(*(_cm(points) for points in found.points))
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = answer.rotation, np.asarray(answer.translation).reshape(3) / 1e2
            pose = rigid(matrix)
            if within_prior(pose, problem.prior):
                poses.append(_gicp(problem, pose))
        return best(problem, poses)

    return find


def _cm(points: Array) -> list[Array]:
    return [row.astype(np.float32) for row in points * 1e2]


def _gicp(problem: PeerProblem, pose: Pose) -> Pose:
    """One alignment by small_gicp, CAD samples to scan."""
    found = small_gicp.align(
        np.asarray(problem.coarse_scan.points),
        np.asarray(problem.coarse_samples.points),
        pose.matrix,
        registration_type="GICP",
        downsampling_resolution=COARSE_M,
        max_correspondence_distance=3 * COARSE_M,
        max_iterations=30,
    )
    return rigid(np.asarray(found.T_target_source))


def _multistart() -> Finder:
    def find(problem: PeerProblem) -> Pose:
        target, target_tree = _gicp_cloud(problem.coarse_scan.voxel_down_sample(2 * COARSE_M))
        source, _ = _gicp_cloud(problem.coarse_samples.voxel_down_sample(2 * COARSE_M))
        poses = []
        for start in _starts():
            found = small_gicp.align(
                target,
                source,
                target_tree,
                start.matrix,
                registration_type="GICP",
                max_correspondence_distance=0.012,
                max_iterations=25,
            )
            poses.append(rigid(np.asarray(found.T_target_source)))
        return best(problem, poses)

    return find


def _gicp_cloud(cloud: Any) -> tuple[Any, Any]:
    points = small_gicp.PointCloud(np.asarray(cloud.points))
    tree = small_gicp.KdTree(points)
    small_gicp.estimate_normals_covariances(points, tree, 15)
    return points, tree


def _starts() -> Iterator[Pose]:
    """Over the whole of the usual prior: 13 places sideways, 3 along, 5 axes; rolls of up to 15 deg lie in reach."""
    ring = [(0.0, 0.0)] + [(0.016 * np.cos(a), 0.016 * np.sin(a)) for a in np.arange(4) * np.pi / 2]
    ring += [(0.032 * np.cos(a), 0.032 * np.sin(a)) for a in np.arange(8) * np.pi / 4]
    tilts = np.deg2rad([(0, 0), (12, 0), (-12, 0), (0, 12), (0, -12)])
    for (x, y), z, (u, v) in itertools.product(ring, (-0.018, 0.0, 0.018), tilts):
        yield Pose.from_rotvec([u, v, 0.0], [x, y, z])


def _ppf() -> Finder:
    cv2: Any = importlib.import_module("cv2")
    ppf = cv2.ppf_match_3d
    trained: dict[str, Any] = {}

    def find(problem: PeerProblem) -> Pose:
        detector = trained.get(problem.model.checksum)
        if detector is None:
            detector = ppf.PPF3DDetector(_PPF_STEP, 0.05, 30)
            detector.trainModel(_rows(problem.coarse_samples.voxel_down_sample(_PPF_M)))
            trained[problem.model.checksum] = detector
        answers = detector.match(_rows(problem.coarse_scan.voxel_down_sample(_PPF_M)), 1.0 / 5.0, _PPF_STEP)
        return best(problem, [rigid(np.asarray(answer.pose)) for answer in answers[:100]])

    return find


def _rows(cloud: Any) -> Array:
    """(N, 6) points and normals in single precision, as OpenCV wants them."""
    return np.ascontiguousarray(np.hstack([cloud.points, cloud.normals]), dtype=np.float32)


PEERS: dict[str, Peer] = {
    peer.name: peer
    for peer in (
        Peer("open3d-ransac", "Open3D FPFH + RANSAC + ICP", "open3d", lambda: _ransac),
        Peer("open3d-fgr", "Open3D FGR + ICP", "open3d", lambda: _fgr),
        Peer("icp", "point-to-plane ICP from the prior", "open3d", lambda: _from_prior),
        Peer("multistart", "many-start small_gicp + ICP", "small_gicp", _multistart),
        Peer("kiss", "FPFH + KISS-Matcher + small_gicp + ICP", "kiss_matcher", _kiss),
        Peer("ppf", "OpenCV point-pair features + ICP", "cv2.ppf_match_3d", _ppf),
    )
}
