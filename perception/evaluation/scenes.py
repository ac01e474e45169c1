"""Simulated scans with their truth: one sweep past a vehicle, and merged views around one port.

The front door of the simulator: scenes (``scene``), the sensor (``sensor``) and tiers (``tiers``) come together here.
Everything is drawn from the injected generator, so a seed names a scan for good.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from perception.estimate import Prior
from perception.evaluation.built import TYPICAL, BuiltTolerance
from perception.evaluation.cuts import disc_cut, integrity_cut, random_cuts
from perception.evaluation.scene import (
    KINDS,
    NEGATIVES,
    PORTLESS,
    Negative,
    Scene,
    SceneSpec,
    build_scene,
    negatives_for,
)
from perception.evaluation.sensor import Mask, SensorModel, Sweep, cast_profile, cast_sweep, port_hits
from perception.evaluation.tiers import TIERS, Range, Tier, TierName
from perception.evaluation.vehicle import SIDES, Occluder, Rng
from perception.evaluation.views import FIVE_VIEWS, SimulatedViews, View, simulate_views
from perception.geometry import Array, Pose
from perception.outline import outline_bounds
from perception.port_shape import PortShape
from perception.port_solid import Ints
from perception.scan import Cloud

_OCCLUDERS: tuple[Occluder, ...] = ("cable", "hand", "box")
_FACING = np.diag([1.0, -1.0, -1.0])
"""Rotation of a port that the scanner looks at squarely: port x along scanner x, port y up, port z to the scanner."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedScan:
    """A sweep as a site would record it, and what is true of it."""

    port: str
    tier: TierName
    negative: Negative | None
    cloud: Cloud
    """Scanner frame at mid-sweep; with the laser's origins."""
    T_scanner_port: Pose
    prior: Prior
    on_port: Mask
    """(N,) good points on the inlet."""
    profile: Ints
    """(N,) number of the profile that each point belongs to."""
    ray: Ints
    """(N,) number of the ray within its profile."""
    part: Ints
    """(N,) index into ``port_solid.PARTS``, -1 off the inlet."""
    normals: Array
    """(N, 3) true surface normals in the scanner frame; zero for flying points."""
    noise_m: float
    outliers: float
    integrity: float
    """Share of the port's points that the cut left; 0 where there is no port."""
    cover_corners: Array | None
    """(8, 3) corners of the open cover's box in the scanner frame."""


@dataclass(frozen=True, slots=True)
class Bound:
    """Cramer-Rao bound of the pose from the scan's own good points: 1 sigma, root sum of squares of three axes."""

    translation_m: float
    rotation_rad: float


def simulate_scan(
    shape: PortShape,
    tier: TierName,
    rng: Rng,
    *,
    negative: Negative | None = None,
    integrity: float | None = None,
    extra_roll_rad: float = 0.0,
    tolerance: BuiltTolerance | None = None,
) -> SimulatedScan:
    """One sweep of a vehicle with ``shape`` (or a negative in its place).

    :param integrity: share of the port's points left by the cut; None: drawn from the tier.
    :param extra_roll_rad: rolls the port beyond what the prior says, for scans that must be refused.
    """
    limits = TIERS[tier]
    spec = _draw_spec(shape, limits, rng, negative, tolerance or TYPICAL)
    scene = build_scene(spec, rng)
    sensor = _draw_sensor(limits, rng)
    T_scanner_prior = _prior_pose(shape, sensor.standoff_m)
    T_prior_port = _draw_offset(limits, rng, extra_roll_rad)
    truth = T_scanner_prior @ T_prior_port
    share = float(rng.uniform(*limits.integrity)) if integrity is None else integrity
    scene, unblocked = _unblocked(scene, truth, share)
    sweep = _sweep(scene, truth, sensor, limits, rng)
    scan = _labelled(scene, sweep, truth, Prior(T_scanner_prior), tier, sensor, min(share / unblocked, 1.0), rng)
    return replace(scan, integrity=scan.integrity * unblocked)


def _unblocked(scene: Scene, T_scanner_port: Pose, share: float) -> tuple[Scene, float]:
    """The scene, without its occluders if they hide too much, and the share of the port that the laser reaches."""
    if scene.built is None:
        return scene, 1.0
    pose = T_scanner_port.inverse()
    poses = [pose.moved([0.0, y, 0.0]) for y in np.arange(-0.13, 0.13, 0.004)]
    alone = scene.without("occluder").without("cover").without("clutter")
    reached = port_hits(scene, poses) / max(port_hits(alone, poses), 1)
    if reached >= share or not scene.spec.occluders:
        return scene, max(reached, 1e-3)
    return _unblocked(_bare(scene), T_scanner_port, share)


def _bare(scene: Scene) -> Scene:
    return replace(scene.without("occluder"), spec=replace(scene.spec, occluders=()))


def cramer_rao(scan: SimulatedScan) -> Bound:
    """The least error that an unbiased estimator can have, from noise and geometry of the good points alone.

    The noise is taken along the surface's normal. Sweep-speed error, vibration and the inlet's deviations from its
    drawing are not part of it, so from nominal on it cannot always be reached.
    """
    normals = scan.T_scanner_port.inverse().rotate(scan.normals[scan.on_port])
    points = scan.T_scanner_port.inverse().apply(scan.cloud.points[scan.on_port])
    jacobian = np.hstack([normals, np.cross(points, normals)])
    covariance = np.linalg.inv(jacobian.T @ jacobian) * scan.noise_m**2
    variance = np.diag(covariance)
    return Bound(float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3:].sum())))


def _draw_spec(
    shape: PortShape, tier: Tier, rng: Rng, negative: Negative | None, tolerance: BuiltTolerance
) -> SceneSpec:
    cover = SIDES[int(rng.integers(4))] if rng.random() < tier.cover else None
    kind = _OCCLUDERS[int(rng.integers(3))]
    occluders = (kind,) if rng.random() < tier.occluder else ()
    return SceneSpec(shape, negative, cover, occluders, int(rng.integers(tier.clutter + 1)), tolerance)


def _draw_sensor(tier: Tier, rng: Rng) -> SensorModel:
    standoff = float(rng.uniform(0.185, 0.375))
    return SensorModel(
        points_per_profile=int(rng.uniform(*tier.rays)),
        window_m=float(rng.uniform(0.19, 0.24)),
        standoff_m=standoff,
        near_m=max(0.05, standoff - 0.15),
        far_m=standoff + 0.16,
        baseline_m=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.22, 0.45) * standoff),
        noise_m=float(rng.uniform(*tier.noise_mm)) / 1000.0,
        outliers=float(rng.uniform(*tier.outliers)),
        patchiness=float(rng.uniform(*tier.patchiness)),
    )


def _prior_pose(shape: PortShape, standoff_m: float) -> Pose:
    """T_scanner_port that a site expects: squarely in front, the middle of the inlet in the middle of the sweep."""
    _, low_y, _, high_y = outline_bounds(shape.rim)
    return Pose(_FACING.copy(), np.array([0.0, (low_y + high_y) / 2, standoff_m]))


def _draw_offset(tier: Tier, rng: Rng, extra_roll_rad: float) -> Pose:
    """T_prior_port: where the port is, seen from where it was expected."""
    lateral, aim = rng.uniform(*tier.lateral_mm) / 1000.0, rng.uniform(0.0, 2 * np.pi)
    along = _signed(tier.along_mm, rng) / 1000.0
    tilt, axis = np.deg2rad(rng.uniform(*tier.tilt_deg)), rng.uniform(0.0, 2 * np.pi)
    roll = np.deg2rad(_signed(tier.roll_deg, rng)) + extra_roll_rad
    rotation = Rotation.from_rotvec([tilt * np.cos(axis), tilt * np.sin(axis), 0.0]) * Rotation.from_rotvec(
        [0, 0, roll]
    )
    return Pose(rotation.as_matrix(), np.array([lateral * np.cos(aim), lateral * np.sin(aim), along]))


def _signed(limits: Range, rng: Rng) -> float:
    return float(rng.uniform(*limits) * rng.choice([-1.0, 1.0]))


def _sweep(scene: Scene, T_scanner_port: Pose, sensor: SensorModel, tier: Tier, rng: Rng) -> Sweep:
    """Profiles along y of the scanner frame; what the arm reports differs from where it was (speed, vibration)."""
    length, pitch = rng.uniform(0.20, 0.26), rng.uniform(0.0006, 0.0009)
    count = round(length / pitch)
    y = (np.arange(count) - count // 2) * pitch  # the middle profile is taken at y = 0: its frame is the scan's
    T_port_scanner = T_scanner_port.inverse()
    believed = [T_port_scanner.moved([0.0, step, 0.0]) for step in y]
    shake = _vibration(len(y), rng) * rng.uniform(*tier.vibration_mm) / 1000.0
    shake[:, 1] += y * rng.normal(0.0, 1.0) * tier.speed_error
    true = [pose.moved(offset) for pose, offset in zip(believed, shake, strict=True)]
    return cast_sweep(scene, true, sensor, rng, believed=believed)


def _vibration(count: int, rng: Rng) -> Array:
    """(count, 3) displacement of about unit amplitude on each axis: two structural modes of the arm."""
    phase = np.linspace(0.0, 1.0, count)[:, None]
    cycles, start = rng.uniform(15.0, 80.0, (2, 3)), rng.uniform(0.0, 2 * np.pi, (2, 3))
    first, second = (np.sin(2 * np.pi * cycles[k] * phase + start[k]) for k in range(2))
    moved: Array = 0.7 * first + 0.3 * second
    return moved


def _labelled(
    scene: Scene,
    sweep: Sweep,
    truth: Pose,
    prior: Prior,
    tier: TierName,
    sensor: SensorModel,
    share: float,
    rng: Rng,
) -> SimulatedScan:
    """The sweep after the integrity cut, in true frames, with its labels."""
    port_points = sweep.good & (sweep.face >= 0) & (scene.kind[sweep.face] == KINDS.index("port"))
    in_port = truth.inverse().apply(sweep.cloud.points)
    keep = random_cuts(in_port, port_points, share, rng) | (sweep.face < 0)
    face = sweep.face[keep]
    flying = face < 0
    normals = np.where(flying[:, None], 0.0, truth.rotate(_face_normals(scene)[face]))
    cloud = Cloud(sweep.cloud.points[keep], "scanner", _origins(sweep.cloud)[keep])
    return SimulatedScan(
        port=scene.spec.shape.name,
        tier=tier,
        negative=scene.spec.negative,
        cloud=cloud,
        T_scanner_port=truth,
        prior=prior,
        on_port=port_points[keep],
        profile=sweep.profile[keep],
        ray=sweep.ray[keep],
        part=np.where(flying, -1, scene.part[face]),
        normals=normals,
        noise_m=sensor.noise_m,
        outliers=sensor.outliers,
        integrity=float(port_points[keep].sum() / max(port_points.sum(), 1)),
        cover_corners=None if scene.cover_corners is None else truth.apply(scene.cover_corners),
    )


def _origins(cloud: Cloud) -> Array:
    if cloud.origins is None:
        raise ValueError("a simulated sweep knows its origins")
    return cloud.origins


def _face_normals(scene: Scene) -> Array:
    """(F, 3) unit normals of the scene's faces, port frame."""
    a, b, c = (scene.vertices[scene.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    unit: Array = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    return unit


__all__ = [
    "FIVE_VIEWS",
    "NEGATIVES",
    "PORTLESS",
    "TIERS",
    "Bound",
    "Negative",
    "Scene",
    "SceneSpec",
    "SensorModel",
    "SimulatedScan",
    "SimulatedViews",
    "Sweep",
    "TierName",
    "View",
    "build_scene",
    "cast_profile",
    "cast_sweep",
    "cramer_rao",
    "disc_cut",
    "integrity_cut",
    "negatives_for",
    "simulate_scan",
    "simulate_views",
]
