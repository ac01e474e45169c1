"""Several scans of one port: registered to each other and to the model; the arm believed where they disagree."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.cli.main import app
from controller.port_files import load_port
from controller.port_models import port_model
from perception import views_locate
from perception.errors import InputError, PortdockError
from perception.estimate import PortEstimate
from perception.evaluation.locate_views import TwoViews, two_views
from perception.geometry import Pose, exp
from perception.scan import Cloud
from perception.views_joint import register_views
from perception.views_locate import ViewsEstimate, locate_views

PORT = "ccs2"
SHAPE = load_port(PORT).shape


@pytest.fixture(scope="module")
def views() -> TwoViews:
    return two_views(SHAPE, 0.7, np.random.default_rng(4))


def test_views_displaced_by_millimetres_come_to_lie_on_each_other(views: TwoViews) -> None:
    displaced = [exp([0.0006, -0.0004, 0.0004, 0.006, -0.004, 0.004]) @ pose.inverse() for pose in views.T_view_port]
    displaced[1] = exp([-0.0006, 0.0004, -0.0004, -0.004, 0.004, 0.0]) @ displaced[1]
    found = register_views([cloud.points for cloud in views.clouds], displaced, port_model(PORT))
    true = views.T_view_port[0] @ views.T_view_port[1].inverse()
    relative = found[0].inverse() @ found[1]
    port = views.T_view_port[1]  # compared at the port, not at the scanner
    assert (relative @ port).distance_to(true @ port) < 0.0002
    assert np.rad2deg(relative.angle_to(true)) < 0.15


@pytest.fixture(scope="module")
def found(views: TwoViews) -> ViewsEstimate:
    return locate_views(views.clouds, port_model(PORT), views.prior, views.T_first_view)


def test_the_merged_scan_holds_both_and_the_port_is_found(views: TwoViews, found: ViewsEstimate) -> None:
    assert len(found.cloud) == sum(len(cloud) for cloud in views.clouds)
    assert found.used == (True, True)
    assert found.estimate.T_ref_port.distance_to(views.T_view_port[0]) < 0.0005


@pytest.mark.parametrize("kept", [0.02, 0.0], ids=["glare", "nothing near the port"])
def test_a_view_that_shows_hardly_anything_of_the_port_does_no_harm(views: TwoViews, kept: float) -> None:
    seen, blinded = views.clouds
    away = np.linalg.norm(views.T_view_port[1].inverse().apply(blinded.points), axis=1) > 0.08
    few = away | (np.random.default_rng(0).random(len(away)) < kept)
    assert blinded.origins is not None
    poor = Cloud(blinded.points[few], blinded.frame, blinded.origins[few])
    found = locate_views([seen, poor], port_model(PORT), views.prior, views.T_first_view)
    assert not found.alone[1].accepted
    assert found.estimate.accepted
    assert found.estimate.T_ref_port.distance_to(views.T_view_port[0]) < 0.0005


def test_what_two_scans_say_is_their_mean_as_uncertain_as_they_are_apart(views: TwoViews, found: ViewsEstimate) -> None:
    told = [T @ one.T_ref_port for T, one in zip(views.T_first_view, found.alone, strict=True)]
    middle = 0.5 * (told[0].translation + told[1].translation)
    assert np.linalg.norm(found.estimate.T_ref_port.translation - middle) < 1e-9
    assert found.estimate.accepted
    assert "found in 2 of 2 scans" in found.estimate.reasons[0]
    apart = told[0].distance_to(told[1])
    assert np.sqrt(np.trace(found.estimate.covariance[:3, :3])) > 0.4 * apart


def test_scans_that_disagree_by_more_than_an_arm_errs_are_refused(views: TwoViews) -> None:
    wrong = [views.T_first_view[0], exp([0.0, 0.002, 0.0, 0.0, 0.0, 0.0]) @ views.T_first_view[1]]
    found = locate_views(views.clouds, port_model(PORT), views.prior, wrong)
    assert all(one.accepted for one in found.alone)
    assert not found.estimate.accepted
    assert "the scans disagree about the port by" in found.estimate.reasons[0]


def test_without_the_arms_poses_a_first_scan_that_does_not_show_the_port_is_a_refusal(views: TwoViews) -> None:
    seen = views.clouds[1]
    away = np.linalg.norm(views.T_view_port[0].inverse().apply(views.clouds[0].points), axis=1) > 0.08
    assert views.clouds[0].origins is not None
    blinded = Cloud(views.clouds[0].points[away], seen.frame, views.clouds[0].origins[away])
    found = locate_views([blinded, seen], port_model(PORT), views.prior)
    assert not found.estimate.accepted
    assert "give the arm's poses" in found.estimate.reasons[0]


def test_scans_that_fit_nowhere_near_where_the_arm_says_are_refused_though_their_blur_would_pass(
    views: TwoViews, found: ViewsEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    accepted, merged = found.estimate, sum(len(cloud) for cloud in views.clouds)

    def only_the_blur(cloud: Cloud, *_: object) -> PortEstimate:
        return replace(accepted, accepted=len(cloud) == merged)

    def elsewhere(clouds: object, poses: list[Pose], model: object) -> tuple[Pose, ...]:
        return poses[0], exp([0.004, 0.0, 0.0, 0.0, 0.0, 0.0]) @ poses[1]

    monkeypatch.setattr(views_locate, "locate", only_the_blur)
    together = locate_views(views.clouds, port_model(PORT), views.prior, views.T_first_view)
    assert together.estimate.accepted
    monkeypatch.setattr(views_locate, "register_views", elsewhere)
    apart = locate_views(views.clouds, port_model(PORT), views.prior, views.T_first_view)
    assert not apart.estimate.accepted
    assert "do not fit to each other" in apart.estimate.reasons[0]


def test_one_scan_is_nothing_to_merge(views: TwoViews) -> None:
    with pytest.raises(InputError, match="one scan"):
        locate_views(views.clouds[:1], port_model(PORT))


def test_the_command_line_merges_with_the_arms_poses_and_writes_one_page(views: TwoViews, tmp_path: Path) -> None:
    files = []
    for name, cloud in zip("ab", views.clouds, strict=True):
        files.append(tmp_path / f"{name}.npz")
        np.savez(files[-1], points=cloud.points)
    T_base_first = Pose.from_rotvec([1.0, 0.5, 0.0], [0.4, 0.1, 0.9])
    poses = [(T_base_first @ pose).matrix.tolist() for pose in views.T_first_view]
    (tmp_path / "poses.json").write_text(json.dumps({"poses": poses}))
    (tmp_path / "prior.json").write_text(json.dumps({"prior": views.prior.T_ref_port.matrix.tolist()}))
    arguments = [*map(str, files), "--model", PORT, "--merge", "--poses", str(tmp_path / "poses.json")]
    options = ["--prior", str(tmp_path / "prior.json"), "--report", str(tmp_path / "report"), "--json"]
    result = CliRunner().invoke(app, ["locate", *arguments, *options])
    record = json.loads(result.stdout)
    assert record["scan"] == "a+b"
    assert Pose.from_matrix(record["T"]).distance_to(views.T_view_port[0]) < 0.0005
    assert "cover" in record
    page = (tmp_path / "report" / "a+b.html").read_text()
    assert "contacts and wells" in page


@pytest.mark.parametrize("content", ["{", "[]", '{"poses": [1]}', '{"poses": [[1], [2]]}'])
def test_bad_poses_are_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "poses.json").write_text(content)
    scan = tmp_path / "a.npz"
    np.savez(scan, points=np.random.default_rng(1).uniform(0, 0.1, (500, 3)))
    arguments = ["locate", str(scan), str(scan), "--model", PORT, "--merge", "--poses", str(tmp_path / "poses.json")]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, PortdockError)
