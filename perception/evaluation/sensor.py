"""A laser-line profiler that is ray-cast: what it measures of a scene, with the faults that triangulation has.

The laser fans out in the plane y = 0 of the scanner frame; the camera sits ``baseline_m`` beside it along y, so a point
must be lit by the laser *and* seen by the camera. Modelled: shadows, range noise along the ray, mixed pixels at edges,
flying points, drop-outs by grazing incidence, by material and in patches, glare. Not modelled: laser speckle,
inter-reflections, motion blur within a profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from perception.evaluation.scene import KINDS, Scene
from perception.geometry import Array, Pose
from perception.port_solid import PARTS, Ints
from perception.scan import Cloud

Mask = NDArray[np.bool_]

_SMALL_CAST = 4096
"""Up to so many rays one thread is faster than starting several."""
_EDGE_STEP_M = (0.0015, 0.080)
"""A jump in range between neighbouring rays within these bounds can give a mixed pixel."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """A profiler's geometry and its faults."""

    points_per_profile: int = 1000
    window_m: float = 0.16
    """Width of the laser line at the stand-off."""
    standoff_m: float = 0.29
    near_m: float = 0.11
    far_m: float = 0.50
    baseline_m: float = -0.10
    """Camera's place along y of the scanner frame; its sign says on which side of the line shadows fall."""
    noise_m: float = 0.0001
    """1 sigma of the range at normal incidence; grows as the beam's footprint does."""
    outliers: float = 0.005
    """Share of rays that give a point where nothing is: half anywhere, half near a surface."""
    mixed_pixels: float = 0.4
    """Share of rays at a depth edge whose point lies between the two surfaces."""
    dropout: float = 1.0
    """Strength of the drop-outs by material and incidence; 0 switches them off."""
    patchiness: float = 0.5
    """Strength of the patches without return; 0 switches them off."""
    glare: float = 0.0
    """Share of returns lost within ``glare_radius_m`` of the port."""
    glare_radius_m: float = 0.09


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Many profiles of one scene as one cloud, with what is true of each point."""

    cloud: Cloud
    """Points and laser origins in the scanner frame at mid-sweep."""
    profile: Ints
    """(N,) number of the profile that each point belongs to."""
    ray: Ints
    """(N,) number of the ray within its profile."""
    face: Ints
    """(N,) face of the scene that was hit; -1 for a flying point."""
    good: Mask
    """(N,) measured where the surface is: neither a flying point nor a mixed pixel."""
    T_port_scanner: Pose
    """Where the scanner believes it was at mid-sweep; the cloud's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """P profiles of M rays: unit directions in the scanner frame, ranges, and what is true of them."""

    direction: Array  # (M, 3)
    distance: Array  # (P, M)
    valid: Mask  # (P, M)
    face: Ints  # (P, M)
    good: Mask  # (P, M)


def cast_profile(scene: Scene, T_port_scanner: Pose, sensor: SensorModel, rng: np.random.Generator) -> Array:
    """One profile: (M, 2) x and z in metres in the laser plane, valid points only."""
    measured = _measure(scene, [T_port_scanner], sensor, rng)
    valid = measured.valid[0]
    xz: Array = measured.distance[0, valid, None] * measured.direction[valid][:, [0, 2]]
    return xz


def cast_sweep(
    scene: Scene,
    poses: Sequence[Pose],
    sensor: SensorModel,
    rng: np.random.Generator,
    *,
    believed: Sequence[Pose] | None = None,
) -> Sweep:
    """A profile from each of ``poses`` (T_port_scanner), merged by the ``believed`` poses (default: the true ones)."""
    measured = _measure(scene, poses, sensor, rng)
    reported = poses if believed is None else believed
    middle = reported[len(reported) // 2]
    relative = [middle.inverse() @ pose for pose in reported]
    profile, ray = np.nonzero(measured.valid)
    local = measured.distance[profile, ray, None] * measured.direction[ray]
    rotations = np.stack([pose.rotation for pose in relative])[profile]
    origins = np.stack([pose.translation for pose in relative])[profile]
    points = np.einsum("nij,nj->ni", rotations, local) + origins
    face, good = measured.face[profile, ray], measured.good[profile, ray]
    return Sweep(Cloud(points, "scanner", origins), profile, ray, face, good, middle)


def port_hits(scene: Scene, poses: Sequence[Pose]) -> int:
    """How many rays of a coarse sweep from ``poses`` meet the inlet first: faultless, without the camera."""
    direction = _fan(SensorModel(points_per_profile=120, window_m=0.26))
    rotations = np.stack([pose.rotation for pose in poses])
    rays = np.einsum("pij,mj->pmi", rotations, direction).reshape(-1, 3)
    origins = np.repeat(np.stack([pose.translation for pose in poses]), len(direction), axis=0)
    _, face, _ = _cast(scene, origins, rays)
    return int((scene.kind[face[face >= 0]] == KINDS.index("port")).sum())


def _measure(scene: Scene, poses: Sequence[Pose], sensor: SensorModel, rng: np.random.Generator) -> _Measured:
    """Cast, shadow, drop and disturb all rays of all profiles at once."""
    direction = _fan(sensor)
    rotations = np.stack([pose.rotation for pose in poses])
    origins = np.repeat(np.stack([pose.translation for pose in poses])[:, None], len(direction), axis=1)
    rays = np.einsum("pij,mj->pmi", rotations, direction)
    cast = _cast(scene, origins.reshape(-1, 3), rays.reshape(-1, 3))
    distance, face, normal = cast
    hit = np.isfinite(distance)
    distance = np.where(hit, distance, sensor.standoff_m)
    points = origins.reshape(-1, 3) + distance[:, None] * rays.reshape(-1, 3)
    cameras = np.repeat(np.stack([p.apply(np.array([0.0, sensor.baseline_m, 0.0])) for p in poses]), len(direction), 0)
    cosine = np.abs(np.einsum("ni,ni->n", normal, rays.reshape(-1, 3)))
    seen = hit & _seen(scene, points, cameras, normal)
    seen &= rng.random(len(seen)) >= _loss(scene, sensor, points, face, cosine)
    shape = (len(poses), len(direction))
    noise = sensor.noise_m / np.sqrt(np.clip(cosine, 0.25, 1.0)) * rng.standard_normal(len(seen))
    clean, seen, face = distance.reshape(shape), seen.reshape(shape), face.reshape(shape)
    measured = _disturbed(clean, noise.reshape(shape), seen, face, sensor, rng)
    return _Measured(direction, *measured)


def _fan(sensor: SensorModel) -> Array:
    """Unit directions (M, 3) of the laser's rays in the scanner frame, evenly spaced on a plane across the beam."""
    x = np.linspace(-0.5, 0.5, sensor.points_per_profile) * sensor.window_m / sensor.standoff_m
    fan = np.column_stack([x, np.zeros_like(x), np.ones_like(x)])
    unit: Array = fan / np.linalg.norm(fan, axis=1, keepdims=True)
    return unit


def _cast(scene: Scene, origins: Array, rays: Array) -> tuple[Array, Ints, Array]:
    """Distance (inf: no hit), face number (-1) and unit normal of what each ray meets first."""
    tensor = o3d.core.Tensor.from_numpy(np.hstack([origins, rays]).astype(np.float32))
    answer = scene.caster.cast_rays(tensor, nthreads=1 if len(rays) <= _SMALL_CAST else 0)
    distance = answer["t_hit"].numpy().astype(np.float64)
    face = np.where(np.isfinite(distance), answer["primitive_ids"].numpy().astype(np.int64), -1)
    return distance, face, answer["primitive_normals"].numpy().astype(np.float64)


def _seen(scene: Scene, points: Array, cameras: Array, normal: Array) -> Mask:
    """Whether the camera sees each point: it looks at the lit side and nothing stands in between."""
    sight = cameras - points
    tensor = o3d.core.Tensor.from_numpy(np.hstack([points, sight]).astype(np.float32))
    threads = 1 if len(points) <= _SMALL_CAST else 0
    blocked: Mask = scene.caster.test_occlusions(tensor, tnear=3e-4, tfar=0.999, nthreads=threads).numpy()
    faces_camera: Mask = np.einsum("ni,ni->n", sight, normal) > 0.02 * np.linalg.norm(sight, axis=1)
    seen: Mask = ~blocked & faces_camera
    return seen


def _loss(scene: Scene, sensor: SensorModel, points: Array, face: Ints, cosine: Array) -> Array:
    """Probability that a ray gives no point: material, grazing incidence, patches, glare."""
    base = _material_loss(scene, face) * sensor.dropout
    grazing = np.clip((0.30 - cosine) / 0.25, 0.0, 1.0) ** 2 * sensor.dropout
    hollow = _patch_loss(scene, sensor, points, face)
    glare = sensor.glare * (np.linalg.norm(points[:, :2], axis=1) < sensor.glare_radius_m)
    kept: Array = (1 - base) * (1 - grazing) * (1 - hollow) * (1 - glare)
    return 1.0 - kept


_KIND_LOSS = np.array([0.06, 0.03, 0.03, 0.04, 0.05, 0.05, 0.05])
"""Share of returns that each of ``KINDS`` loses, met squarely."""
_PIN_LOSS = 0.15


def _material_loss(scene: Scene, face: Ints) -> Array:
    """(N,) share of returns lost by material: black plastic and bright pins lose most. Arbitrary without a hit."""
    loss: Array = np.where(scene.part[face] == PARTS.index("pin"), _PIN_LOSS, _KIND_LOSS[scene.kind[face]])
    return loss


def _patch_loss(scene: Scene, sensor: SensorModel, points: Array, face: Ints) -> Array:
    """(N,) share of returns lost where the patch field is high: sooner on the black plastic of the inlet."""
    if sensor.patchiness <= 0:
        return np.zeros(len(points))
    on_port = scene.kind[face] == KINDS.index("port")
    threshold = np.where(on_port, 2.6, 3.1) - 1.2 * sensor.patchiness
    lost: Array = 0.95 / (1.0 + np.exp(-12.0 * (scene.patches.level(points) - threshold)))
    return lost


def _disturbed(
    clean: Array, noise: Array, seen: Mask, face: Ints, sensor: SensorModel, rng: np.random.Generator
) -> tuple[Array, Mask, Ints, Mask]:
    """(distance, valid, face, good) after mixed pixels, noise and flying points; all (P, M)."""
    step = np.diff(clean, axis=1, append=clean[:, -1:])
    both = seen & np.roll(seen, -1, axis=1)
    edge = both & (np.abs(step) > _EDGE_STEP_M[0]) & (np.abs(step) < _EDGE_STEP_M[1])
    # A spot on an edge belongs to the ray before it as often as to the one after.
    chance, share = rng.random(clean.shape), rng.random(clean.shape)
    before = edge & (chance < 0.5 * sensor.mixed_pixels)
    after = np.roll(edge & ~before & (chance < sensor.mixed_pixels), 1, axis=1) & ~before
    mixed = before | after
    between = np.where(before, share * step, 0.0) - np.where(after, np.roll(share * step, 1, axis=1), 0.0)
    distance = clean + between + noise
    flying = rng.random(clean.shape) < sensor.outliers
    near = flying & (rng.random(clean.shape) < 0.5)
    off = rng.uniform(0.0015, 0.008, clean.shape) * rng.choice([-1.0, 1.0], clean.shape)
    anywhere = rng.uniform(max(sensor.standoff_m - 0.10, sensor.near_m), sensor.standoff_m + 0.08, clean.shape)
    distance = np.where(flying, np.where(near & seen, clean + off, anywhere), distance)
    valid = (seen | flying) & (distance > sensor.near_m) & (distance < sensor.far_m)
    return distance, valid, np.where(flying, -1, face), seen & ~flying & ~mixed
