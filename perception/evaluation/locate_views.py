"""Two sweeps of one vehicle, each with its own part of the port hidden: what merging viewpoints is tested on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.estimate import Prior
from perception.evaluation.cuts import random_cuts
from perception.evaluation.scene import KINDS, Scene, SceneSpec, build_scene
from perception.evaluation.sensor import SensorModel, cast_sweep
from perception.evaluation.vehicle import Rng
from perception.geometry import Pose, exp
from perception.port_shape import PortShape
from perception.scan import Cloud

_NOISE_M, _OUTLIERS = 0.00025, 0.08
CALIBRATED = (0.0002, float(np.deg2rad(0.03)))
"""(m, rad), 1 sigma of each axis: how well an arm knows from where the second sweep was taken, seen from the first."""
UNCALIBRATED = (0.0006, float(np.deg2rad(0.15)))
"""The same with a mounting from a drawing."""
_STANDOFF_M = 0.28


@dataclass(frozen=True, slots=True, eq=False)
class TwoViews:
    """Two sweeps with their truth."""

    clouds: tuple[Cloud, Cloud]
    T_view_port: tuple[Pose, Pose]
    T_first_view: tuple[Pose, Pose]
    """As the arm tells it."""
    prior: Prior


def two_views(shape: PortShape, integrity: float, rng: Rng, arm_sigma: tuple[float, float] = CALIBRATED) -> TwoViews:
    """Sweeps from straight ahead and from the side, each lacking its own ``1 - integrity`` of the port."""
    scene = build_scene(SceneSpec(shape), rng)
    facing = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, _STANDOFF_M]))
    offset = exp(np.concatenate([rng.uniform(-0.02, 0.02, 3), np.deg2rad(rng.uniform(-6.0, 6.0, 3))]))
    turn = exp([0, 0, 0, 0, np.deg2rad(rng.choice([-1, 1]) * rng.uniform(12, 20)), 0])
    poses = (facing @ offset, facing @ turn @ offset)
    clouds = (_sweep(scene, poses[0], integrity, rng), _sweep(scene, poses[1], integrity, rng))
    told = poses[0] @ poses[1].inverse() @ exp(rng.normal(0.0, np.repeat(arm_sigma, 3)))
    return TwoViews(clouds, poses, (Pose.identity(), told), Prior(facing))


def _sweep(scene: Scene, T_scanner_port: Pose, integrity: float, rng: Rng) -> Cloud:
    sensor = SensorModel(
        points_per_profile=450, window_m=0.2, standoff_m=_STANDOFF_M, noise_m=_NOISE_M, outliers=_OUTLIERS
    )
    pose = T_scanner_port.inverse()
    y = (np.arange(276) - 276 // 2) * 0.0008  # the middle profile is taken at y = 0: its frame is the scan's
    sweep = cast_sweep(scene, [pose.moved([0.0, step, 0.0]) for step in y], sensor, rng)
    on_port = sweep.good & (sweep.face >= 0) & (scene.kind[sweep.face] == KINDS.index("port"))
    local = T_scanner_port.inverse().apply(sweep.cloud.points)
    keep = random_cuts(local, on_port, integrity, rng) | (sweep.face < 0)
    origins = None if sweep.cloud.origins is None else sweep.cloud.origins[keep]
    return Cloud(sweep.cloud.points[keep], "scanner", origins)
