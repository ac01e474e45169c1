"""Rays cast at the CAD: they bring a port home across its axis and in roll, and tell how surely and how long it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from controller.port_files import load_port
from perception.crop import Scene, crop
from perception.evaluation.scenes import SimulatedScan, simulate_scan
from perception.geometry import Pose
from perception.port_model import PortModel
from perception.port_solid import build_mesh
from perception.rays import COARSE_M, FINEST_M, Rays, fit_rays, ray_costs, telling
from perception.stretch import fit_stretch

NOISE_M = 0.0001


@pytest.fixture(scope="module")
def model() -> PortModel:
    return PortModel.from_mesh("j1772", *build_mesh(load_port("j1772").shape))


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    return simulate_scan(load_port("j1772").shape, "easy", np.random.default_rng(4))


@pytest.fixture(scope="module")
def scene(scan: SimulatedScan, model: PortModel) -> Scene:
    return crop(scan.cloud, model, scan.prior)


@pytest.fixture(scope="module")
def truth(scan: SimulatedScan) -> Pose:
    return scan.prior.T_ref_port.inverse() @ scan.T_scanner_port


@pytest.fixture(scope="module")
def rays(scene: Scene, model: PortModel, truth: Pose) -> Rays:
    near = model.nearest.lookup(truth.inverse().apply(scene.points)) < model.nearest.none
    return telling(truth, Rays(scene.points[near], scene.origins[near]), model, NOISE_M, COARSE_M[0])


def from_above(xy: list[list[float]], z: float) -> tuple[np.ndarray, np.ndarray]:
    points = np.column_stack([xy, np.full(len(xy), z)])
    return points, points + np.array([0.0, 0.0, 0.25])


def test_a_ray_meets_the_rim_where_the_drawing_has_it_and_nothing_beside_the_port(model: PortModel) -> None:
    rim = model.surface.points[np.argmin(np.abs(model.surface.points[:, 2]))]
    _, origins = from_above([[rim[0], rim[1]], [0.5, 0.5]], 0.0)
    met = model.solid.cast(origins, np.tile([0.0, 0.0, -1.0], (2, 1)))
    assert met.distance[0] == pytest.approx(0.25, abs=0.0005)
    assert met.tells.tolist() == [True, False]
    assert np.isinf(met.distance[1])


def test_a_loose_flat_tells_nothing() -> None:
    shape = load_port("type2").shape
    vertices, faces = build_mesh(shape)
    fixed = PortModel.from_mesh("fixed", vertices, faces)
    level = float(fixed.flats.heights[0])
    loose = PortModel.from_mesh("loose", vertices, faces, loose_heights_m=(level,))
    on = fixed.surface.points[
        (np.abs(fixed.surface.points[:, 2] - level) < 1e-4) & (fixed.surface.normals[:, 2] > 0.99)
    ]
    _, origins = from_above(on[:, :2].tolist(), level)
    down = np.tile([0.0, 0.0, -1.0], (len(on), 1))
    seen = np.abs(fixed.solid.cast(origins, down).distance - 0.25) < 1e-4
    assert seen.sum() > 20
    assert fixed.solid.cast(origins, down).tells[seen].all()
    assert not loose.solid.cast(origins, down).tells[seen].any()


def test_a_ray_costs_nothing_where_it_should_end_and_no_more_than_a_cap_elsewhere(model: PortModel) -> None:
    rim = model.surface.points[np.argmin(np.abs(model.surface.points[:, 2]))]
    points, origins = from_above([[rim[0], rim[1]]] * 3, 0.0)
    met = model.solid.cast(origins, np.tile([0.0, 0.0, -1.0], (3, 1)))
    points[:, 2] = 0.25 - met.distance + np.array([0.0, NOISE_M, 0.03])
    costs = ray_costs(Pose.identity(), Rays(points, origins), model, NOISE_M)
    assert costs[0] == pytest.approx(0.0, abs=1e-3)
    assert costs[1] == pytest.approx(0.5, abs=0.01)
    assert costs[2] == pytest.approx(4.0)


@pytest.mark.parametrize("off", [[0.0007, -0.0006, 2.0], [-0.0008, 0.0002, -2.0]])
def test_a_pose_off_across_the_axis_and_in_roll_comes_home(
    model: PortModel, truth: Pose, rays: Rays, off: list[float]
) -> None:
    start = truth @ Pose.from_rotvec([0.0, 0.0, np.deg2rad(off[2])], [off[0], off[1], 0.0])
    coarse = fit_rays(start, rays, model, NOISE_M, COARSE_M)
    found = fit_rays(coarse.T_prior_port, rays, model, NOISE_M, (0.0002, *FINEST_M)).T_prior_port
    assert found.distance_to(truth) < 0.0001
    assert found.angle_to(truth) < np.deg2rad(0.15)


def test_the_result_costs_no_more_than_the_start(model: PortModel, truth: Pose, rays: Rays) -> None:
    rng = np.random.default_rng(1)
    no_contact = np.flatnonzero(model.floating.at(truth.inverse().apply(rays.points)[:, :2]) == 0)  # weighed down else
    for _ in range(12):  # of so few rays the quadratic means little
        few = rays.only(rng.choice(no_contact, 40, replace=False))
        fit = fit_rays(truth, few, model, NOISE_M, FINEST_M)
        found, told = fit.T_prior_port, cKDTree(few.points).query(fit.T_prior_port.apply(fit.local))[1]
        before, after = (ray_costs(pose, few.only(told), model, NOISE_M).sum() for pose in (truth, found))
        assert after <= before + 1e-3


def test_half_of_the_rays_know_half_as_much(model: PortModel, truth: Pose, rays: Rays) -> None:
    all_of_them = fit_rays(truth, rays, model, NOISE_M, (0.0002,))
    half = fit_rays(truth, rays.only(np.arange(0, len(rays.points), 2)), model, NOISE_M, (0.0002,))
    share = np.diag(half.information)[:2] / np.diag(all_of_them.information)[:2]
    assert np.all((share > 0.35) & (share < 0.75))  # contacts' rays are weighed down where they are many


def test_what_nothing_tells_is_unknown_and_not_negative(model: PortModel, truth: Pose, rays: Rays) -> None:
    fit = replace(fit_rays(truth, rays, model, NOISE_M, (0.0002,)), information=np.diag([1e9, 1e9, -5.0]))
    assert np.linalg.eigvalsh(fit.known).min() > 0
    assert np.sqrt(np.linalg.inv(fit.known)[2, 2]) > np.deg2rad(5.0)


@pytest.mark.parametrize("share", [-0.008, 0.008])
def test_a_scan_that_is_too_long_along_the_sweep_shows_by_how_much_and_where_the_port_is_then(
    model: PortModel, scene: Scene, truth: Pose, rays: Rays, share: float
) -> None:
    along = (rays.origins - scene.sweep_middle) @ scene.sweep_direction
    longer = (share * along)[:, None] * scene.sweep_direction
    stretched = Rays(rays.points + longer, rays.origins + longer)
    at = float(np.median(along))
    seen = Pose(truth.rotation, truth.translation + share * at * scene.sweep_direction)
    found = fit_stretch(seen, stretched, scene, model, NOISE_M)
    plain = fit_stretch(truth, rays, scene, model, NOISE_M)
    assert found.share - plain.share == pytest.approx(share, abs=0.0012)
    assert found.port_at_m == pytest.approx(at, abs=0.001)
    assert found.displaced() @ scene.sweep_direction == pytest.approx(0.4 * found.share * at, abs=1e-6)


def test_a_model_made_ready_has_what_the_first_scan_would_wait_for(model: PortModel) -> None:
    fresh = replace(model)
    assert "solid" not in vars(fresh)
    fresh.make_ready()
    assert {"solid", "tree", "contacts", "lenient_flats"} <= set(vars(fresh))


def test_a_step_taken_back_does_not_make_the_fit_surer(model: PortModel, truth: Pose, rays: Rays) -> None:
    rng = np.random.default_rng(2)
    distances_m = (0.0004, 0.0001)
    for _ in range(12):  # of so few rays some take their first step at the finer distance back
        few = rays.only(rng.choice(len(rays.points), 40, replace=False))
        fit = fit_rays(truth, few, model, NOISE_M, distances_m)
        told = cKDTree(few.points).query(fit.T_prior_port.apply(fit.local))[1]
        there = [fit_rays(fit.T_prior_port, few.only(told), model, NOISE_M, (one,)) for one in distances_m]
        assert fit.information[0, 0] < 3.0 * max(1e8, *(one.information[0, 0] for one in there))
