"""The unit in which times are given: what preparing the same scan takes in Open3D, in the same process.

Crop to where the prior lets the port be, voxel grid, removal of statistical outliers, normals. Wall time on a busy
machine says little, so processor time is taken too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any, TypeVar

import numpy as np
import open3d as o3d

from perception.evaluation.locate_cases import CaseScan
from perception.geometry import Array
from perception.port_model import PortModel

T = TypeVar("T")

VOXEL_M = 0.001
NEIGHBOURS = 20
OUTLIER_SIGMA = 2.0


@dataclass(frozen=True, slots=True)
class Times:
    """Seconds."""

    wall_s: float
    cpu_s: float


def timed(work: Callable[[], T]) -> tuple[T, Times]:
    """What ``work`` returns and how long it took."""
    wall, cpu = perf_counter(), process_time()
    answer = work()
    return answer, Times(perf_counter() - wall, process_time() - cpu)


def prepared(scan: CaseScan, model: PortModel) -> Any:
    """The scan as an Open3D cloud in the prior's frame: cropped, thinned, cleaned, with normals to the sensor."""
    T_prior_ref = scan.prior.T_ref_port.inverse()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(T_prior_ref.apply(scan.cloud.points)))
    cloud = cloud.crop(o3d.geometry.AxisAlignedBoundingBox(*bounds(scan, model)))
    cloud = cloud.voxel_down_sample(VOXEL_M)
    cloud, _ = cloud.remove_statistical_outlier(NEIGHBOURS, OUTLIER_SIGMA)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    cloud.orient_normals_towards_camera_location(T_prior_ref.translation)
    return cloud


def bounds(scan: CaseScan, model: PortModel) -> tuple[Array, Array]:
    """Corners (3,) of the box in the prior's frame that holds the port wherever the prior allows it to be."""
    low, high = model.size
    radius = float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))[:2]))
    prior = scan.prior
    swing = np.array([*[0.5 * radius * np.sin(prior.roll_rad)] * 2, radius * np.sin(prior.tilt_rad)])
    reach = np.array([prior.lateral_m, prior.lateral_m, prior.along_m]) + swing
    return low - reach, high + reach
