"""The yardsticks that users know: Open3D's FPFH + RANSAC and fast global registration, each followed by ICP.

Both are global: they use no start pose and no rounds. Millimetres.
"""

from __future__ import annotations

from time import process_time
from typing import Any, Literal

import numpy as np
import open3d as o3d

from perception.evaluation.baseline2 import fpfh_cloud
from perception.evaluation.outcomes import Iterate, Outcome, Problem, Stopwatch
from perception.geometry import Array, Pose

_registration: Any = o3d.pipelines.registration
_FEATURE_RADIUS_MM = 15.0
_PAIR_MM = 4.5
_ITERATIONS = 100_000
_ICP_GATES_MM = (3.0, 1.5)


class Open3DPeer:
    """Prepared for one target (M, 3). ``icp=False`` stops after the global step."""

    def __init__(self, target: Array, engine: Literal["ransac", "fgr"], *, icp: bool = True) -> None:
        self._engine, self._icp = engine, icp
        self._thin, self._features = fpfh_cloud(target, radius=_FEATURE_RADIUS_MM, max_nn=100)
        self._dense = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(target))
        self._dense.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(24))

    def __call__(self, problem: Problem) -> Outcome:
        """One iterate: there is nothing to repeat."""
        watch = Stopwatch(process_time)
        o3d.utility.random.seed(problem.seed % 2**31)
        thin, features = fpfh_cloud(problem.test, radius=_FEATURE_RADIUS_MM, max_nn=100)
        matrix = self._ransac(thin, features) if self._engine == "ransac" else self._fgr(thin, features)
        if self._icp:
            matrix = self._refined(problem.test, matrix)
        return (Iterate(_rigid(matrix), None, watch.lap()),)

    def _ransac(self, thin: Any, features: Any) -> Array:
        found = _registration.registration_ransac_based_on_feature_matching(
            thin,
            self._thin,
            features,
            self._features,
            True,
            _PAIR_MM,
            _registration.TransformationEstimationPointToPoint(False),
            3,
            [
                _registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                _registration.CorrespondenceCheckerBasedOnDistance(_PAIR_MM),
            ],
            _registration.RANSACConvergenceCriteria(_ITERATIONS, 0.999),
        )
        return np.asarray(found.transformation)

    def _fgr(self, thin: Any, features: Any) -> Array:
        option = _registration.FastGlobalRegistrationOption(maximum_correspondence_distance=_PAIR_MM)
        found = _registration.registration_fgr_based_on_feature_matching(
            thin, self._thin, features, self._features, option
        )
        return np.asarray(found.transformation)

    def _refined(self, test: Array, matrix: Array) -> Array:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(test))
        for gate in _ICP_GATES_MM:
            estimation = _registration.TransformationEstimationPointToPlane()
            criteria = _registration.ICPConvergenceCriteria(max_iteration=30)
            found = _registration.registration_icp(cloud, self._dense, gate, matrix, estimation, criteria)
            matrix = np.asarray(found.transformation)
        return matrix


def _rigid(matrix: Array) -> Pose:
    """The nearest rigid transform: Open3D's rotations are orthonormal to single precision only."""
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    return Pose(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt, matrix[:3, 3].copy())
