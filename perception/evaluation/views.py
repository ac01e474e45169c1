"""Views of one port from several sides, merged into one cloud: the data of the published evaluation.

Unlike a sweep there is no prior and no labelled surface, and the cloud holds just as many points as asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.evaluation.scene import Scene, SceneSpec, build_scene
from perception.evaluation.sensor import Mask, SensorModel, cast_sweep
from perception.evaluation.vehicle import SIDES, Rng
from perception.geometry import Array, Pose
from perception.outline import outline_bounds
from perception.port_shape import PortShape
from perception.port_solid import Ints
from perception.scan import Cloud


@dataclass(frozen=True, slots=True)
class View:
    """A direction from which a port is seen: azimuth to the right and elevation upwards of straight ahead (rad)."""

    azimuth_rad: float
    elevation_rad: float
    distance_m: float = 0.42


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedViews:
    """Views of one port merged into one cloud, and where the port truly is in it."""

    cloud: Cloud
    T_cloud_port: Pose
    view: Ints
    """(N,) number of the view that each point comes from."""
    good: Mask
    """(N,) no outlier."""


FIVE_VIEWS = tuple(
    View(float(np.deg2rad(azimuth)), float(np.deg2rad(elevation)))
    for azimuth, elevation in ((0, 0), (-28, 5), (28, 5), (0, 25), (3, -25))
)
"""Straight ahead and from four sides: what the published evaluation calls a complete scan."""


def simulate_views(
    shape: PortShape,
    views: Sequence[View],
    n_points: int,
    noise_m: float,
    outliers: float,
    rng: Rng,
    *,
    start: tuple[float, float] = (0.0, 0.0),
    scene: Scene | None = None,
    margin_m: float = 0.012,
) -> SimulatedViews:
    """``n_points`` surface points of the port from several views, plus ``outliers`` (a share) on top, in sensor order.

    :param start: rotation (rad) about a random axis through the port's origin, and shift (m), of the cloud's frame.
    :param scene: the vehicle to look at; None: one is drawn, with an open cover, from ``rng``.
    :param margin_m: how far beyond the inlet's outline, and in front of it, points are kept.
    """
    scene = scene or build_scene(SceneSpec(shape, cover=SIDES[int(rng.integers(4))]), rng)
    parts = [_look(scene, view, noise_m, rng) for view in views]
    points = np.vstack(parts)
    number = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    low, high = _crop_box(shape, margin_m)
    inside = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
    chosen = np.sort(rng.choice(inside, min(n_points, len(inside)), replace=False))
    clutter, origin_of = _outlier_points(points[chosen], round(outliers * len(chosen)), low, high, rng)
    merged = np.vstack([points[chosen], clutter])
    displacement = _start_pose(start, rng)
    good = np.arange(len(merged)) < len(chosen)
    view = np.concatenate([number[chosen], number[chosen][origin_of]])
    return SimulatedViews(Cloud(displacement.apply(merged)), displacement, view, good)


def _look(scene: Scene, view: View, noise_m: float, rng: Rng) -> Array:
    """Points (N, 3), port frame, of a dense sweep from one view."""
    low_x, low_y, high_x, high_y = outline_bounds(scene.spec.shape.rim)
    centre = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2, 0.0])
    az, el = view.azimuth_rad, view.elevation_rad
    towards = np.array([np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)])
    x_axis = np.array([np.cos(az), 0.0, -np.sin(az)])
    rotation = np.column_stack([x_axis, np.cross(-towards, x_axis), -towards])
    middle = Pose(rotation, centre + view.distance_m * towards)
    half = max(high_x - low_x, high_y - low_y) / 2 + 0.03
    poses = [middle.moved([0.0, y, 0.0]) for y in np.arange(-half, half, 0.0007)]
    sensor = SensorModel(
        points_per_profile=round(2 * half / 0.0007),
        window_m=2 * half,
        standoff_m=view.distance_m,
        far_m=view.distance_m + 0.2,
        baseline_m=float(rng.choice([-0.08, 0.08])),
        noise_m=noise_m,
        outliers=0.0,
        patchiness=0.2,
    )
    sweep = cast_sweep(scene, poses, sensor, rng)
    return sweep.T_port_scanner.apply(sweep.cloud.points)


def _crop_box(shape: PortShape, margin_m: float) -> tuple[Array, Array]:
    """Smallest and largest corner of the box around the inlet, port frame."""
    face = shape.rim if shape.flange is None else shape.flange.outline
    low_x, low_y, high_x, high_y = outline_bounds(face)
    low = np.array([low_x - margin_m, low_y - margin_m, -shape.back_depth_m])
    return low, np.array([high_x + margin_m, high_y + margin_m, margin_m + 0.03])


def _outlier_points(points: Array, count: int, low: Array, high: Array, rng: Rng) -> tuple[Array, Ints]:
    """``count`` outliers, half anywhere in the box, half 1.5 to 8 mm off a point; and the point each belongs to."""
    source = rng.integers(len(points), size=count)
    away = rng.normal(size=(count, 3))
    away *= rng.uniform(0.0015, 0.008, (count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    anywhere = rng.uniform(low, high, (count, 3))
    half = (np.arange(count) < count // 2)[:, None]
    return np.where(half, anywhere, points[source] + away), source


def _start_pose(start: tuple[float, float], rng: Rng) -> Pose:
    axis, shift = rng.normal(size=3), rng.normal(size=3)
    return Pose.from_rotvec(axis / np.linalg.norm(axis) * start[0], shift / np.linalg.norm(shift) * start[1])
