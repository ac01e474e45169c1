"""A port is found to a centimetre in ranges that are each off by one, and a vehicle without a port is not one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from controller.port_files import load_port
from controller.port_models import port_model
from mocks.scanner import scip
from perception.errors import EmptyScanError
from perception.estimate import Prior
from perception.evaluation.range_finder import ranges_from
from perception.evaluation.scene import Negative, SceneSpec, build_scene
from perception.geometry import Array, Pose
from perception.rough import RoughPlace, find_roughly
from perception.scan import Cloud

PRIOR = Prior(Pose.from_vector([0.9, 0.1, 0.4, 0.3, -1.2, 0.8]), lateral_m=0.15, along_m=0.08)
STEPS = slice(256 - scip.FIRST, 513 - scip.FIRST)
"""45 degrees to either side."""


@cache
def surface(port: str) -> Array:
    return port_model(port).surface.points.astype(np.float64)


def scanned(port: str, place_m: tuple[float, float, float], seed: int, negative: Negative | None = None) -> Cloud:
    """A sweep along y at 0.4 m in the base frame: 10 mm of noise on each range, 10 mm that a surface adds to all."""
    rng = np.random.default_rng(seed)
    scene = build_scene(SceneSpec(load_port(port).shape, negative), rng)
    T_prior_port = Pose.from_rotvec(np.deg2rad(rng.uniform(-4, 4, 3)), np.array(place_m))
    bias, angles, points = rng.normal(0.0, 0.010, 7), scip.ANGLES_RAD[STEPS], []
    for y in np.arange(-0.22, 0.22, 0.0035):
        T_prior_scanner = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, y, 0.4]))
        true_m, kind = ranges_from(scene, T_prior_port.inverse() @ T_prior_scanner, angles, rng)
        hit = np.isfinite(true_m)
        measured_m = np.round((true_m + bias[kind] + rng.normal(0.0, 0.010, len(true_m)))[hit], 3)
        local = np.stack([np.sin(angles[hit]), np.zeros(hit.sum()), np.cos(angles[hit])], axis=1)
        points.append(T_prior_scanner.apply(measured_m[:, None] * local))
    return Cloud(PRIOR.T_ref_port.apply(np.concatenate(points)), "base")


def off_mm(found: RoughPlace, place_m: tuple[float, float, float]) -> Array:
    return ((PRIOR.T_ref_port.inverse() @ found.T_ref_port).translation - np.array(place_m)) * 1e3


@pytest.mark.parametrize("port", ["ccs2", "ccs1", "type2", "nacs"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_place_is_right_to_a_centimetre_sideways_and_three_along(port: str, seed: int) -> None:
    place_m = ((0.08, -0.06, 0.04), (-0.10, 0.03, -0.05))[seed]
    found = find_roughly(scanned(port, place_m, seed), surface(port), PRIOR)
    assert found.found
    dx, dy, dz = off_mm(found, place_m)
    assert np.hypot(dx, dy) < 10.0
    assert abs(dz) < 30.0
    np.testing.assert_allclose(found.T_ref_port.rotation, PRIOR.T_ref_port.rotation)


@pytest.mark.parametrize("negative", ["plain", "closed-cover"])
@pytest.mark.parametrize("port", ["ccs2", "type2"])
def test_a_vehicle_without_an_open_port_is_told_from_one(port: str, negative: Negative) -> None:
    assert not find_roughly(scanned(port, (0.05, 0.0, 0.0), 2, negative), surface(port), PRIOR).found


def test_a_scan_of_elsewhere_is_refused_with_the_count() -> None:
    elsewhere = Cloud(np.full((5000, 3), 3.0), "base")
    with pytest.raises(EmptyScanError, match="0 points"):
        find_roughly(elsewhere, surface("ccs2"), PRIOR)


def test_the_place_stays_within_the_priors_bound() -> None:
    """A port farther off than that is not reported there, nor anywhere else with conviction."""
    near = Prior(PRIOR.T_ref_port, lateral_m=0.05, along_m=0.08)
    found = find_roughly(scanned("ccs2", (0.13, 0.0, 0.0), 3), surface("ccs2"), near)
    offset = (PRIOR.T_ref_port.inverse() @ found.T_ref_port).translation
    assert np.hypot(offset[0], offset[1]) <= 0.05
