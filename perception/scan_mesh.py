"""A merged scan of an inlet -> a surface mesh that a port model can be prepared from.

Ball pivoting through thinned points (Bernardini et al., IEEE TVCG 5, 1999): it keeps measured points where they are,
unlike a fit of a closed surface, which rounds the edges that decide the roll. Holes stay holes.
"""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from perception.errors import DegenerateCloudError
from perception.geometry import Array

SPACING_M = 0.0008
_BALLS = (1.1, 2.0, 3.5)
"""Ball radii in spacings."""
_MIN_POINTS = 2000


def mesh_from_points(points: Array, spacing_m: float = SPACING_M) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3) of the surface that points (N, 3) lie on, all in metres and the port frame.

    :raises DegenerateCloudError: too few points, or points that form no surface.
    """
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(spacing_m)
    cloud, _ = cloud.remove_statistical_outlier(16, 2.5)
    if len(cloud.points) < _MIN_POINTS:
        raise DegenerateCloudError(
            f"{len(cloud.points)} points {spacing_m * 1e3:.1f} mm apart are too few for a port model",
            remedy="Merge more scans of the port (portdock merge), and crop them to the port.",
        )
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(16))
    cloud.orient_normals_to_align_with_direction(np.array([0.0, 0.0, 1.0]))  # seen from the front
    radii = o3d.utility.DoubleVector([spacing_m * ball for ball in _BALLS])
    mesh = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(cloud, radii)
    faces = np.asarray(mesh.triangles, dtype=np.int64)
    if len(faces) < _MIN_POINTS:
        raise DegenerateCloudError("the points form no surface", remedy="Give a dense scan with little noise.")
    return np.asarray(mesh.vertices, dtype=np.float64), faces
