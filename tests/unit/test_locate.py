"""The locator finds the port in recorded and simulated scans, and refuses what is not the port it was asked for."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from controller.port_files import load_port
from controller.port_models import port_model
from perception.cloud_io import read_cloud
from perception.crop import crop
from perception.estimate import PortEstimate, Prior
from perception.evaluation.scenes import SimulatedScan, simulate_scan
from perception.geometry import Pose
from perception.locate import locate
from perception.mesh_io import read_mesh
from perception.port_model import PortModel
from perception.scan import Cloud

SHARED = Path(__file__).parents[3] / "shared" / "scans"


@pytest.fixture(scope="module")
def type2() -> PortModel:
    return port_model("type2")


@pytest.fixture(scope="module")
def recording() -> tuple[Cloud, Prior, Pose]:
    file = resources.files("mocks.recordings") / "type2-nominal.npz"
    with resources.as_file(file) as path, np.load(path) as data:
        cloud = read_cloud(path)
        return cloud, Prior(Pose.from_matrix(data["prior"])), Pose.from_matrix(data["T_scanner_port"])


@pytest.fixture(scope="module")
def found(type2: PortModel, recording: tuple[Cloud, Prior, Pose]) -> PortEstimate:
    cloud, prior, _ = recording
    return locate(cloud, type2, prior)


def error_mm_deg(estimate: PortEstimate, truth: Pose) -> tuple[float, float]:
    pose = estimate.T_ref_port
    return pose.distance_to(truth) * 1e3, float(np.rad2deg(pose.angle_to(truth)))


def simulated(negative: str | None = None, roll_deg: float = 0.0, seed: int = 11) -> SimulatedScan:
    shape = load_port("type2").shape
    rng = np.random.default_rng(seed)
    return simulate_scan(shape, "easy", rng, negative=negative, extra_roll_rad=np.deg2rad(roll_deg))  # type: ignore[arg-type]


def test_a_recorded_port_is_accepted_where_it_is(found: PortEstimate, recording: tuple[Cloud, Prior, Pose]) -> None:
    millimetres, degrees = error_mm_deg(found, recording[2])
    assert found.accepted, found.reasons
    assert millimetres < 0.5
    assert degrees < 0.5
    assert found.ref == "scanner"
    assert [name for name, _ in found.timings_s][-1] == "total"


def test_the_covariance_is_positive_and_in_proportion_to_the_error(
    found: PortEstimate, recording: tuple[Cloud, Prior, Pose]
) -> None:
    values = np.linalg.eigvalsh(found.covariance)
    error = found.T_ref_port.inverse() @ recording[2]
    vector = np.concatenate([error.translation, error.rotvec])
    assert values[0] > 0
    assert vector @ np.linalg.solve(found.covariance, vector) < 60.0


def test_the_answer_moves_with_the_frame_of_the_scan(
    type2: PortModel, recording: tuple[Cloud, Prior, Pose], found: PortEstimate
) -> None:
    cloud, prior, _ = recording
    T_base_scanner = Pose.from_rotvec([0.3, -1.1, 0.7], [0.5, -0.2, 0.9])
    moved = cloud.transformed(T_base_scanner, "base")
    estimate = locate(moved, type2, Prior(T_base_scanner @ prior.T_ref_port))
    assert estimate.ref == "base"
    assert estimate.T_ref_port.distance_to(T_base_scanner @ found.T_ref_port) < 0.0002


def test_the_same_scan_gives_the_same_answer(
    type2: PortModel, recording: tuple[Cloud, Prior, Pose], found: PortEstimate
) -> None:
    again = locate(recording[0], type2, recording[1])
    assert np.array_equal(again.T_ref_port.matrix, found.T_ref_port.matrix)


@pytest.mark.parametrize("negative", ["plain", "empty-pocket", "dust-cap", "plug-inserted", "no-contacts"])
def test_what_is_no_free_port_is_refused_with_a_reason(type2: PortModel, negative: str) -> None:
    scan = simulated(negative)
    estimate = locate(scan.cloud, type2, scan.prior)
    assert not estimate.accepted
    assert estimate.reasons


def test_a_round_port_rolled_beyond_the_prior_is_refused(type2: PortModel) -> None:
    scan = simulated(roll_deg=60.0)
    assert not locate(scan.cloud, type2, scan.prior).accepted


def test_another_port_type_is_refused(recording: tuple[Cloud, Prior, Pose]) -> None:
    assert not locate(recording[0], port_model("j1772"), recording[1]).accepted


def test_a_scan_with_the_port_cut_out_is_refused(type2: PortModel, recording: tuple[Cloud, Prior, Pose]) -> None:
    cloud, prior, truth = recording
    aside = np.hypot(*truth.inverse().apply(cloud.points)[:, :2].T)
    assert cloud.origins is not None
    rest = Cloud(cloud.points[aside > 0.034], "scanner", cloud.origins[aside > 0.034])
    assert not locate(rest, type2, prior).accepted


def test_a_scan_away_from_the_prior_is_refused_not_crashed(
    type2: PortModel, recording: tuple[Cloud, Prior, Pose]
) -> None:
    cloud, prior, _ = recording
    estimate = locate(cloud, type2, Prior(prior.T_ref_port.moved([0.0, 0.0, 2.0])))
    assert not estimate.accepted
    assert estimate.verdict == "no-port"


@pytest.mark.skipif(not SHARED.exists(), reason="the shared scans are not here")
@pytest.mark.parametrize("name", ["type2-nominal-1", "gbt_dc-nominal-2", "ccs2-easy-1"])
def test_shared_scans_are_located(name: str) -> None:
    content = json.loads((SHARED / f"{name}.json").read_text())
    vertices, faces = read_mesh(SHARED / "ports" / f"{content['port']}.stl")
    model = PortModel.from_mesh(content["port"], vertices, faces)
    estimate = locate(read_cloud(SHARED / f"{name}.ply"), model, Prior(Pose.from_matrix(content["prior"])))
    millimetres, degrees = error_mm_deg(estimate, Pose.from_matrix(content["T"]))
    assert estimate.accepted, estimate.reasons
    assert millimetres < 0.3
    assert degrees < 0.3


def test_a_scan_of_a_sweep_that_went_slowly_is_thinned_evenly_and_located_as_well(
    type2: PortModel, recording: tuple[Cloud, Prior, Pose], monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud, prior, truth = recording
    whole = crop(cloud, type2, prior)
    monkeypatch.setattr("perception.crop.MOST_POINTS", len(whole.points) // 2)
    half = crop(cloud, type2, prior)
    assert len(whole.points) // 3 - 1 <= len(half.points) <= len(whole.points) // 2 + 1
    assert np.ptp(half.points, axis=0) == pytest.approx(np.ptp(whole.points, axis=0), rel=0.02)
    millimetres, degrees = error_mm_deg(locate(cloud, type2, prior), truth)
    assert millimetres < 0.5 and degrees < 0.5
