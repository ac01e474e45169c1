"""How well views are merged without a model: the error of each view against truth."""

from __future__ import annotations

import numpy as np

from perception.evaluation.metrics import angle_deg, centre_error_mm
from perception.evaluation.records import MergeRecord
from perception.evaluation.scenes import FIVE_VIEWS, simulate_views
from perception.evaluation.trials import MARGIN_M, as_built, port_centre
from perception.geometry import Array, Pose
from perception.port_shape import PortShape
from perception.published.merging import merge_views

_POINTS, _NOISE_MM, _OUTLIERS = 6000, 0.2, 0.02
_START_RAD, _START_MM = float(np.deg2rad(10.0)), 10.0


def run_merge_trial(shape: PortShape, seed: int, number: int) -> list[MergeRecord]:
    """Five views of one vehicle, each turned by 10 degrees and shifted by 10 mm at random, merged."""
    rng = np.random.default_rng([seed, number, 4])
    scene = as_built(shape, rng)
    views: list[Array] = []
    truths: list[Pose] = []
    for view in FIVE_VIEWS:
        scan = simulate_views(shape, (view,), _POINTS, _NOISE_MM / 1e3, _OUTLIERS, rng, scene=scene, margin_m=MARGIN_M)
        in_port = scan.T_cloud_port.inverse().apply(scan.cloud.points) * 1e3
        axis, shift = rng.normal(size=(2, 3))
        displacement = Pose.from_rotvec(
            axis / np.linalg.norm(axis) * _START_RAD, shift / np.linalg.norm(shift) * _START_MM
        )
        views.append(displacement.apply(in_port))
        truths.append(displacement)
    merged = merge_views(views)
    centre = port_centre(shape)
    records = []
    for step, poses in (("sequential", merged.sequential), ("joint", merged.T_first_view)):
        for k, pose in enumerate(poses):
            error = truths[0].inverse() @ pose @ truths[k]  # within the port's frame; the identity if perfect
            records.append(MergeRecord(number, k, step, angle_deg(error), centre_error_mm(error, centre)))
    return records
