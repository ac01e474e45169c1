"""Scenes of the evaluation: what each condition changes, and one trial's scan with its truth. Millimetres.

Target: a complete merged scan of the vehicle as designed: inlet, pocket, panel and open cover. Test: a vehicle of
the same type as built (pin lengths, draft, radii, panel curvature), ray-cast anew, never the target's own points;
turned and shifted at random, and cut for integrity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from perception.evaluation.built import BuiltTolerance
from perception.evaluation.scene import KINDS, Scene, SceneSpec, build_scene
from perception.evaluation.scenes import FIVE_VIEWS, View, integrity_cut, simulate_views
from perception.geometry import Array, Pose
from perception.port_shape import PortShape, outline_bounds
from perception.published.kdtree_numpy import Mask

TARGET_POINTS, TEST_POINTS = 10_000, 8_000
_TARGET_NOISE_MM = 0.05
MARGIN_M = 0.022
_VEHICLE_SEED = 20_230
"""Of the vehicle type: pocket, panel and cover."""
_PANEL_BEND_M = 0.0004
"""1 sigma of how far the panel as built is off its design at 60 mm from the port."""


Controls = Literal["feedback", "others"]
"""The controls of the feedback, and all others."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Under what circumstances a cell of the evaluation is measured."""

    name: str
    title: str
    integrity: float = 1.0
    noise_mm: float = 0.2
    outliers: float = 0.05
    start_deg: float = 20.0
    start_mm: float = 15.0
    single_view: bool = False
    second_port: bool = False
    rounds: int = 5
    controls: tuple[Controls, ...] = ()
    """Which controls are run beside all methods: see ``methods.Method.control``."""


INTEGRITIES = (1.00, 0.95, 0.90, 0.85, 0.80, 0.75, 0.70, 0.65)


def integrity_condition(p: float) -> Condition:
    """The condition of Figure 6 at integrity p. Complete scans serve Figures 4, 5, 7 and 8 too: ten registrations."""
    controls: tuple[Controls, ...] = ("feedback", "others") if p == 1.0 else ()
    name, title = f"integrity-{round(100 * p):03d}", f"{round(100 * p)} % integrity"
    return Condition(name, title, integrity=p, rounds=10 if p == 1.0 else 5, controls=controls)


COMPLETE = integrity_condition(1.0)
PARTIAL = integrity_condition(0.65)
FAR_START = Condition("start-45", "start 45 deg, 30 mm", start_deg=45.0, start_mm=30.0)
MANY_OUTLIERS = Condition("outliers-30", "30 % outliers", outliers=0.30, controls=("feedback",))
SINGLE_VIEW = Condition("single-view", "one random view", single_view=True)
NOISY = Condition("noise-05", "noise 0.5 mm", noise_mm=0.5)
SECOND_PORT = Condition("second-port", "second port type", second_port=True)
BEYOND_PAPER = (FAR_START, MANY_OUTLIERS, SINGLE_VIEW, NOISY, SECOND_PORT)
ALL_CONDITIONS = (*(integrity_condition(p) for p in INTEGRITIES), *BEYOND_PAPER)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One scan and what is true of it."""

    test: Array
    """(N, 3) mm, displaced from the target's frame."""
    good: Mask
    """(N,) no outlier."""
    T_target_test: Pose
    """The truth."""


def make_target(shape: PortShape) -> Array:
    """(10,000, 3) mm, port frame: the vehicle as designed, from five views. The same for every run."""
    rng = np.random.default_rng(_VEHICLE_SEED)
    noise_m = _TARGET_NOISE_MM / 1e3
    scene = _designed(shape)
    views = simulate_views(shape, FIVE_VIEWS, TARGET_POINTS, noise_m, 0.0, rng, scene=scene, margin_m=MARGIN_M)
    return np.asarray(views.T_cloud_port.inverse().apply(views.cloud.points) * 1e3)


def _designed(shape: PortShape) -> Scene:
    spec = SceneSpec(shape, cover="left", tolerance=BuiltTolerance.none())
    return build_scene(spec, np.random.default_rng(_VEHICLE_SEED))


def as_built(shape: PortShape, rng: np.random.Generator) -> Scene:
    """A vehicle of the designed type: its own inlet within tolerance, its panel bent a little, surfaces of its own."""
    designed, other = _designed(shape), build_scene(SceneSpec(shape), rng)
    around, inlet = designed.kind != KINDS.index("port"), other.kind == KINDS.index("port")
    vertices = designed.vertices.copy()
    bend = rng.normal(0.0, _PANEL_BEND_M, 2) / 0.060**2
    vertices[:, 2] += vertices[:, :2] ** 2 @ bend  # of the surroundings: the inlet comes from the other scene
    return replace(
        designed,
        vertices=np.concatenate([vertices, other.vertices]),
        faces=np.concatenate([designed.faces[around], other.faces[inlet] + len(vertices)]),
        kind=np.concatenate([designed.kind[around], other.kind[inlet]]),
        part=np.concatenate([designed.part[around], other.part[inlet]]),
        patches=other.patches,
        built=other.built,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """A merged scan in the port frame, mm: what conditions that only cut or displace it have in common."""

    points: Array
    good: Mask


@lru_cache(maxsize=2)
def _scan(shape: PortShape, noise_mm: float, outliers: float, single_view: bool, seed: int, number: int) -> _Scan:
    rng = np.random.default_rng([seed, number])
    scene, views = as_built(shape, rng), _views(single_view, rng)
    scan = simulate_views(shape, views, TEST_POINTS, noise_mm / 1e3, outliers, rng, scene=scene, margin_m=MARGIN_M)
    return _Scan(scan.T_cloud_port.inverse().apply(scan.cloud.points) * 1e3, scan.good)


def make_trial(shape: PortShape, condition: Condition, seed: int, number: int) -> Trial:
    """Trial ``number`` of a condition. Vehicle, views and directions depend on seed and number alone, so that all
    conditions see the same vehicles; they differ from trial to trial.
    """
    scan = _scan(shape, condition.noise_mm, condition.outliers, condition.single_view, seed, number)
    keep = integrity_cut(scan.points, condition.integrity, np.random.default_rng([seed, number, 1]))
    axis, shift = np.random.default_rng([seed, number, 2]).normal(size=(2, 3))
    turn = axis / np.linalg.norm(axis) * np.deg2rad(condition.start_deg)
    displacement = Pose.from_rotvec(turn, shift / np.linalg.norm(shift) * condition.start_mm)
    return Trial(displacement.apply(scan.points[keep]), scan.good[keep], displacement.inverse())


def _views(single_view: bool, rng: np.random.Generator) -> tuple[View, ...]:
    """Five jittered views, or one anywhere within reach."""
    if single_view:
        azimuth, elevation = np.deg2rad(rng.uniform([-30.0, -25.0], [35.0, 25.0]))
        return (View(float(azimuth), float(elevation)),)
    jitter = np.deg2rad(rng.uniform(-4.0, 4.0, (len(FIVE_VIEWS), 2)))
    return tuple(
        replace(view, azimuth_rad=view.azimuth_rad + float(a), elevation_rad=view.elevation_rad + float(e))
        for view, (a, e) in zip(FIVE_VIEWS, jitter, strict=True)
    )


def reference_points(shape: PortShape) -> Array:
    """(A, 3) mm: the contacts' axes at their tips, the flange's corners and the centre: points of the common loss."""
    tips = [(*contact.centre_m, -contact.tip_depth_m) for contact in shape.contacts]
    low_x, low_y, high_x, high_y = outline_bounds(shape.rim if shape.flange is None else shape.flange.outline)
    corners = [(x, y, 0.0) for x in (low_x, high_x) for y in (low_y, high_y)]
    return np.array([*tips, *corners, ((low_x + high_x) / 2, (low_y + high_y) / 2, 0.0)]) * 1e3


def port_centre(shape: PortShape) -> Array:
    """(3,) mm: the middle of the inlet's face."""
    low_x, low_y, high_x, high_y = outline_bounds(shape.rim)
    return np.array([(low_x + high_x) / 2, (low_y + high_y) / 2, 0.0]) * 1e3
