"""Simulated scans are what their truth says they are, and the same for the same seed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from controller.port_files import load_port
from mocks import recordings
from perception.errors import ScanFileError
from perception.evaluation import sensor as sensor_module
from perception.evaluation.built import BuiltTolerance
from perception.evaluation.recorded import read_sweep, write_sweep
from perception.evaluation.scenes import (
    FIVE_VIEWS,
    NEGATIVES,
    PORTLESS,
    TIERS,
    Negative,
    Scene,
    SceneSpec,
    SensorModel,
    SimulatedScan,
    TierName,
    build_scene,
    cast_profile,
    cast_sweep,
    cramer_rao,
    integrity_cut,
    negatives_for,
    simulate_scan,
    simulate_views,
)
from perception.geometry import Array, Pose
from perception.port_shape import PortShape
from perception.port_solid import PARTS, build_mesh

TYPE2 = load_port("type2").shape
CCS2 = load_port("ccs2").shape
FACING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.29]))
CLEAN = SensorModel(noise_m=0.0, outliers=0.0, mixed_pixels=0.0, dropout=0.0, patchiness=0.0)
DRAWING = SceneSpec(TYPE2, tolerance=BuiltTolerance.none())


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(DRAWING, np.random.default_rng(0))


@pytest.fixture(scope="module")
def nominal() -> SimulatedScan:
    return simulate_scan(TYPE2, "nominal", np.random.default_rng(5))


def closest_on(mesh: tuple[Array, Array], points: Array) -> Array:
    """The mesh's point nearest to each of points (N, 3)."""
    caster = o3d.t.geometry.RaycastingScene()
    vertices, faces = (o3d.core.Tensor.from_numpy(a.astype(t)) for a, t in zip(mesh, "fI", strict=True))
    caster.add_triangles(vertices, faces)
    answer = caster.compute_closest_points(o3d.core.Tensor.from_numpy(points.astype(np.float32)))
    closest: Array = answer["points"].numpy().astype(np.float64)
    return closest


def distance_to(mesh: tuple[Array, Array], points: Array) -> Array:
    away: Array = np.linalg.norm(closest_on(mesh, points) - points, axis=1)
    return away


def test_a_clean_profile_measures_the_drawing(scene: Scene) -> None:
    profile = cast_profile(scene, FACING, CLEAN, np.random.default_rng(0))
    assert np.abs(profile[:, 0]).max() < 0.09
    depth = profile[:, 1] - 0.29
    on_pe = np.abs(profile[:, 0]) < 0.0024
    assert depth[on_pe] == pytest.approx(0.0067, abs=1e-5)
    on_rim = np.abs(np.abs(profile[:, 0]) - 0.0351) < 0.001
    assert on_rim.sum() > 5
    assert depth[on_rim] == pytest.approx(0.0, abs=1e-5)


def test_the_camera_side_casts_the_shadow(scene: Scene) -> None:
    poses = [FACING.moved([0.0, y, 0.0]) for y in np.linspace(-0.06, 0.06, 60)]

    def lowest_and_highest_floor(baseline_m: float) -> tuple[float, float]:
        sweep = cast_sweep(scene, poses, replace(CLEAN, baseline_m=baseline_m), np.random.default_rng(0))
        points = sweep.T_port_scanner.apply(sweep.cloud.points)
        pocket = points[(points[:, 2] < -0.006) & (np.abs(points[:, 0]) < 0.02) & (np.abs(points[:, 1]) > 0.037)]
        return float(pocket[:, 1].min()), float(pocket[:, 1].max())

    up, down = lowest_and_highest_floor(-0.12), lowest_and_highest_floor(0.12)
    assert up[1] < down[1] - 0.004  # a camera above does not see the floor under the upper wall
    assert up[0] < down[0] - 0.004


def test_labelled_points_lie_on_the_inlet_under_the_truth(nominal: SimulatedScan) -> None:
    points = nominal.T_scanner_port.inverse().apply(nominal.cloud.points[nominal.on_port])
    away = distance_to(build_mesh(TYPE2), points)
    assert np.median(away) < 1.2 * nominal.noise_m
    assert np.quantile(away, 0.95) < 4 * nominal.noise_m + 0.0003
    assert nominal.on_port.sum() > 3000


def test_the_truth_leaves_no_systematic_residual() -> None:
    """What a least-squares fit of the drawing to the labelled points still finds to move stays within a few bounds."""
    scan = simulate_scan(CCS2, "easy", np.random.default_rng(77), tolerance=BuiltTolerance.none())
    port_scanner = scan.T_scanner_port.inverse()
    points = port_scanner.apply(scan.cloud.points[scan.on_port])
    normals = port_scanner.rotate(scan.normals[scan.on_port])
    closest = closest_on(build_mesh(CCS2), points)
    residual = np.einsum("ni,ni->n", points - closest, normals)
    near = np.abs(residual) < 0.0004
    jacobian = np.hstack([normals, np.cross(points, normals)])[near]
    correction = np.linalg.lstsq(jacobian, residual[near], rcond=None)[0]
    bound = cramer_rao(scan)
    assert np.linalg.norm(correction[:3]) < 4 * bound.translation_m
    assert np.linalg.norm(correction[3:]) < 4 * bound.rotation_rad


def test_labels_agree_with_each_other(nominal: SimulatedScan) -> None:
    count = len(nominal.cloud)
    arrays = (nominal.on_port, nominal.part, nominal.normals, nominal.profile, nominal.ray)
    assert all(len(array) == count for array in arrays)
    assert (nominal.part[nominal.on_port] >= 0).all()
    length = np.linalg.norm(nominal.normals, axis=1)
    assert length[nominal.on_port] == pytest.approx(1.0, abs=1e-6)
    assert nominal.cloud.origins is not None
    beam = nominal.cloud.points - nominal.cloud.origins
    assert (np.einsum("ni,ni->n", beam, nominal.normals)[nominal.on_port] < 0).all()
    assert {"rim", "insert", "pin", "flange"} <= {PARTS[k] for k in np.unique(nominal.part[nominal.on_port])}


def test_the_same_seed_gives_the_same_scan_and_another_seed_another() -> None:
    first, again, other = (simulate_scan(TYPE2, "hard", np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first.cloud.points, again.cloud.points)
    assert np.array_equal(first.T_scanner_port.matrix, again.T_scanner_port.matrix)
    assert first.cloud.points.shape != other.cloud.points.shape


@pytest.mark.parametrize("tier", ["easy", "nominal", "hard", "extreme"])
def test_a_scan_keeps_to_its_tier_and_to_its_prior(tier: TierName) -> None:
    limits = TIERS[tier]
    for seed in range(2):
        scan = simulate_scan(CCS2, tier, np.random.default_rng(seed))
        assert limits.noise_mm[0] <= scan.noise_m * 1e3 <= limits.noise_mm[1]
        assert limits.integrity[0] - 0.06 <= scan.integrity <= limits.integrity[1] + 1e-9
        off = scan.prior.T_ref_port.inverse() @ scan.T_scanner_port
        assert np.hypot(*off.translation[:2]) <= scan.prior.lateral_m
        assert abs(off.translation[2]) <= scan.prior.along_m
        assert np.arccos(min(off.rotation[2, 2], 1.0)) <= scan.prior.tilt_rad + 1e-9
        assert abs(np.arctan2(off.rotation[1, 0], off.rotation[0, 0])) <= scan.prior.roll_rad + np.deg2rad(2)
        assert 10_000 < len(scan.cloud) < 260_000
        assert np.isfinite(scan.cloud.points).all()


def test_extra_roll_turns_the_port_beyond_the_prior() -> None:
    scan = simulate_scan(TYPE2, "easy", np.random.default_rng(0), extra_roll_rad=np.pi)
    off = scan.prior.T_ref_port.inverse() @ scan.T_scanner_port
    assert abs(np.arctan2(off.rotation[1, 0], off.rotation[0, 0])) > np.deg2rad(170)


@pytest.mark.parametrize("negative", NEGATIVES)
def test_negatives_show_no_port_to_dock_with(negative: Negative) -> None:
    shape = load_port("gbt_dc").shape if negative != "mirrored" else _lopsided()
    scan = simulate_scan(shape, "easy", np.random.default_rng(4), negative=negative)
    if negative in PORTLESS:
        assert not scan.on_port.any()
        assert (scan.part == -1).all()
        assert scan.integrity == 0.0
        return
    pins = scan.part == PARTS.index("pin")
    if negative in ("dust-cap", "plug-inserted", "no-contacts"):
        assert not pins.any()
    else:
        points = scan.T_scanner_port.inverse().apply(scan.cloud.points[pins])
        assert pins.any()
        assert distance_to(build_mesh(shape), points).max() > 0.001


def _lopsided() -> PortShape:
    """A port whose contacts differ between left and right."""
    shape = load_port("j1772").shape
    moved = replace(shape.contacts[0], centre_m=(-0.0120, 0.0068))
    return replace(shape, contacts=(moved, *shape.contacts[1:]))


def test_a_port_that_is_its_own_mirror_image_has_no_mirrored_negative() -> None:
    assert "mirrored" not in negatives_for(TYPE2)
    assert "mirrored" in negatives_for(_lopsided())
    with pytest.raises(ValueError, match="mirror image"):
        build_scene(SceneSpec(TYPE2, negative="mirrored"), np.random.default_rng(0))


def test_glare_takes_the_points_near_the_port(scene: Scene) -> None:
    rng = np.random.default_rng(0)
    with_glare = cast_profile(scene, FACING, replace(CLEAN, glare=0.97), rng)
    without = cast_profile(scene, FACING, CLEAN, rng)
    assert len(with_glare) < 0.1 * len(without)


def test_noise_is_as_large_as_asked(scene: Scene) -> None:
    noisy = cast_profile(scene, FACING, replace(CLEAN, noise_m=0.0002), np.random.default_rng(1))
    flat = noisy[np.abs(np.abs(noisy[:, 0]) - 0.0395) < 0.0012]
    assert len(flat) > 20
    assert 0.00012 < flat[:, 1].std() < 0.0003


def test_an_open_cover_stands_beside_the_pocket() -> None:
    built = build_scene(SceneSpec(TYPE2, cover="left"), np.random.default_rng(2))
    assert built.cover_corners is not None
    assert built.cover_corners[:, 0].min() < -0.04
    assert built.cover_corners[:, 2].max() > 0.05


def test_views_hold_what_was_asked_for_and_know_the_truth() -> None:
    start = (np.deg2rad(20.0), 0.015)
    views = simulate_views(CCS2, FIVE_VIEWS, 4000, 0.0002, 0.05, np.random.default_rng(0), start=start)
    assert len(views.cloud) == 4200
    assert views.good.sum() == 4000
    assert set(views.view.tolist()) == {0, 1, 2, 3, 4}
    assert views.T_cloud_port.angle_to(Pose.identity()) == pytest.approx(start[0])
    assert views.T_cloud_port.distance_to(Pose.identity()) == pytest.approx(start[1])
    points = views.T_cloud_port.inverse().apply(views.cloud.points[views.good])
    away = distance_to(build_mesh(CCS2), points)
    assert np.quantile(away, 0.4) < 0.0003  # the rest is pocket and panel


@pytest.mark.parametrize("share", [1.0, 0.8, 0.65])
def test_the_integrity_cut_leaves_its_share_on_one_side(share: float) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    keep = integrity_cut(points, share, np.random.default_rng(7))
    assert keep.mean() == pytest.approx(share, abs=0.001)
    if share < 1.0:
        kept, lost = points[keep].mean(axis=0), points[~keep].mean(axis=0)
        assert np.linalg.norm((kept - lost)[:2]) > 0.5


def test_the_bound_shrinks_with_noise_and_is_far_below_it(nominal: SimulatedScan) -> None:
    bound = cramer_rao(nominal)
    assert 0 < bound.translation_m < 0.3 * nominal.noise_m
    halved = cramer_rao(replace(nominal, noise_m=nominal.noise_m / 2))
    assert halved.translation_m == pytest.approx(bound.translation_m / 2)


def test_a_written_sweep_reads_back_as_it_was(nominal: SimulatedScan, tmp_path: Path) -> None:
    count = write_sweep(tmp_path / "sweep.npz", nominal)
    sweep = read_sweep(tmp_path / "sweep.npz")
    assert len(sweep.cloud) == count > 5000
    assert sweep.port == "type2"
    assert sweep.T_scanner_port is not None
    assert sweep.prior is not None
    assert np.allclose(sweep.T_scanner_port.matrix, nominal.T_scanner_port.matrix)
    with np.load(tmp_path / "sweep.npz") as archive:
        x, z, y = archive["profile_x_m"], archive["profile_z_m"], archive["profile_y_m"]
    row, column = np.nonzero(np.isfinite(z))
    assert np.column_stack([x[row, column], y[row], z[row, column]]) == pytest.approx(sweep.cloud.points, abs=1e-5)


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x03\x04 cut short"])
def test_what_is_no_recorded_sweep_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(content)
    with pytest.raises(ScanFileError, match="no recorded sweep"):
        read_sweep(tmp_path / "bad.npz")
    with pytest.raises(ScanFileError):
        read_sweep(tmp_path / "missing.npz")


@pytest.mark.parametrize("name", ["ccs2", "type2"])
def test_bundled_recordings_are_small_and_true(name: str) -> None:
    path = Path(recordings.__file__).parent / f"{name}-nominal.npz"
    assert path.stat().st_size < 400_000
    sweep = read_sweep(path)
    assert sweep.port == name
    assert sweep.T_scanner_port is not None
    points = sweep.T_scanner_port.inverse().apply(sweep.cloud.points)
    away = distance_to(build_mesh(load_port(name).shape), points)
    assert (away < 0.0005).sum() > 4000


def test_mixed_pixels_lie_on_either_side_of_an_edge_equally_often() -> None:
    rows, step_m = 4000, 0.01
    clean = np.repeat([[0.30, 0.30, 0.30, 0.30 + step_m, 0.30 + step_m, 0.30 + step_m]], rows, axis=0)
    seen, face = np.ones(clean.shape, dtype=bool), np.zeros(clean.shape, dtype=np.int64)
    sensor = replace(CLEAN, mixed_pixels=0.4)
    distance, _, _, good = sensor_module._disturbed(clean, 0.0 * clean, seen, face, sensor, np.random.default_rng(5))
    moved = np.abs(distance - clean) > 1e-9
    assert np.array_equal(moved, ~good)
    assert moved[:, [0, 1, 4, 5]].sum() == 0
    assert np.allclose(moved[:, 2:4].mean(axis=0), 0.2, atol=0.02)
    assert ((distance >= 0.30) & (distance <= 0.30 + step_m)).all()
    peak = np.repeat([[0.30, 0.30 - step_m, 0.30]], rows, axis=0)  # one ray wide
    seen, face = np.ones(peak.shape, dtype=bool), np.zeros(peak.shape, dtype=np.int64)
    sensor = replace(CLEAN, mixed_pixels=1.0)
    distance, *_ = sensor_module._disturbed(peak, 0.0 * peak, seen, face, sensor, np.random.default_rng(5))
    assert ((distance >= 0.30 - step_m) & (distance <= 0.30)).all()
