"""The locator's evaluation: what counts as what, exact intervals, calibration, plans, resumption, files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.cli.evaluate_locate import _peers
from controller.port_files import bundled_ports, load_port
from controller.port_models import port_model
from controller.reports.locate_evaluation import write_evaluation_page
from perception.errors import InputError
from perception.evaluation import locate_records as records
from perception.evaluation import locate_runner
from perception.evaluation.locate_cases import (
    MATING,
    NEGATIVE_KINDS,
    Case,
    make_scan,
    negative_cases,
    positive_cases,
    seed_set,
)
from perception.evaluation.locate_folder import folder_cases, read_scan
from perception.evaluation.locate_peer_cloud import within_prior
from perception.evaluation.locate_peers import PEERS, PeerMissingError, peer_pose
from perception.evaluation.locate_records import CaseRecord, error_of
from perception.evaluation.locate_runner import LocatePlan
from perception.evaluation.locate_statistics import calibration, share
from perception.evaluation.locate_summary import summary
from perception.evaluation.locate_write_up import write_results
from perception.geometry import Pose

SHAPES = {name: load_port(name).shape for name in bundled_ports()}
RIGHT = CaseRecord(
    case="port-easy-ccs2-00000",
    kind="port",
    tier="easy",
    port="ccs2",
    asked="ccs2",
    solver="portdock",
    points=100_000,
    integrity=1.0,
    accepted=True,
    verdict="port",
    named="ccs2",
    reasons=("rim and pins are seen",),
    error=(0.0002, 0.0, 0.0, 0.0, 0.001, 0.0),
    covariance=tuple((np.eye(6) * 1e-6).ravel()),
    bound_m=0.0001,
    bound_rad=0.001,
    wall_s=2.0,
    cpu_s=1.0,
    unit_wall_s=0.5,
    unit_cpu_s=0.5,
)
OFF = replace(RIGHT, error=(0.0, 0.0, 0.0, 0.0, 0.0, float(np.deg2rad(90))))


def test_exact_interval_of_a_run_without_failure() -> None:
    # 0.025 ** (1/200): what zero failures in 200 leave possible
    assert share(200, 200).low == pytest.approx(0.025 ** (1 / 200))
    assert share(200, 200).high == 1.0
    assert share(0, 10_000).high == pytest.approx(1 - 0.025 ** (1 / 10_000))


def test_exact_interval_of_a_share_in_between() -> None:
    found = share(48, 60)  # 0.6767 to 0.8922: published tables of Clopper and Pearson
    assert (found.low, found.high) == (pytest.approx(0.6767, abs=1e-4), pytest.approx(0.8922, abs=1e-4))


def test_calibration_of_errors_drawn_from_their_covariance_is_as_predicted() -> None:
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(6, 6)) * 1e-3
    covariance = factor @ factor.T
    errors = rng.multivariate_normal(np.zeros(6), covariance, 4000)
    found = calibration(errors, np.broadcast_to(covariance, (4000, 6, 6)))
    assert found.ellipsoid_at(0.95).value == pytest.approx(0.95, abs=0.015)
    assert all(axis.value == pytest.approx(0.68, abs=0.03) for axis in found.axes_at(0.68))


def test_one_axis_that_is_predicted_too_small_shows_in_its_own_coverage_only() -> None:
    rng = np.random.default_rng(4)
    found = calibration(rng.normal(size=(2000, 6)) * [1, 1, 1, 1, 1, 2], np.broadcast_to(np.eye(6), (2000, 6, 6)))
    assert all(axis.value > 0.93 for axis in found.axes_at(0.95)[:5])
    assert found.axes_at(0.95)[5].value < 0.75


def test_a_right_pose_is_a_success_and_a_turned_one_a_false_accept() -> None:
    assert RIGHT.success
    assert not RIGHT.false_accept
    assert not OFF.success
    assert OFF.false_accept
    assert not replace(OFF, accepted=False).false_accept


def test_accepting_what_is_not_there_is_false_whatever_the_pose() -> None:
    assert replace(RIGHT, kind="dust-cap").false_accept
    assert replace(RIGHT, kind="rolled").false_accept
    assert replace(RIGHT, kind="other-type", port="nacs", error=()).false_accept


def test_a_hardly_visible_port_may_be_accepted_where_it_is() -> None:
    assert not replace(RIGHT, kind="hardly-visible").false_accept
    assert replace(OFF, kind="hardly-visible").false_accept


def test_a_type_2_plug_on_a_ccs2_inlet_is_found() -> None:
    assert replace(RIGHT, named="type2").right_name
    assert not replace(RIGHT, named="ccs1").right_name


def test_refusing_a_right_pose_is_counted_against_right_poses() -> None:
    found = summary([RIGHT, replace(RIGHT, accepted=False), OFF])
    assert (found.false_refusals.hits, found.false_refusals.n) == (1, 2)
    assert found.false_accepts == 1
    assert found.shift_over_bound == pytest.approx(2.0)
    assert (found.units_median, found.cpu_units_median) == (4.0, 2.0)


def test_32_positive_scans_hold_every_port_in_every_tier() -> None:
    cases = positive_cases(32, list(SHAPES))
    assert len({(case.port, case.tier) for case in cases}) == 32


def test_negatives_hold_every_kind_and_never_ask_for_a_plug_that_mates() -> None:
    cases = negative_cases(352, SHAPES)
    assert {case.kind for case in cases} == set(NEGATIVE_KINDS) - {"mirrored"}  # the bundled ports are their own mirror
    assert len({case.name for case in cases}) == 352
    assert all(
        (case.asked, case.port) not in MATING and case.asked != case.port for case in cases if "type" in case.kind
    )


def test_the_same_seed_gives_the_same_scan_and_another_seed_another() -> None:
    (case,) = positive_cases(1, ["nacs"])
    one, two, other = (make_scan(case, seed, SHAPES) for seed in (5, 5, 6))
    assert np.array_equal(one.cloud.points, two.cloud.points)
    assert one.cloud.points.shape != other.cloud.points.shape or not np.allclose(one.cloud.points, other.cloud.points)
    assert one.bound_m > 0


def test_seeds_for_tuning_and_for_acceptance_are_apart() -> None:
    assert (seed_set(999), seed_set(1000)) == ("tuning", "acceptance")


def test_error_is_told_in_the_port_frame() -> None:
    estimated = Pose.from_rotvec([np.pi, 0, 0], [0.1, 0.2, 0.3])
    assert error_of(estimated, estimated.moved([0.001, 0, 0])) == pytest.approx((0.001, 0, 0, 0, 0, 0), abs=1e-12)


def test_answers_survive_the_file_and_an_unfinished_line(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    records.append(path, [RIGHT])
    with path.open("a") as file:
        file.write('{"case": "por')
    assert records.read(path) == [RIGHT]
    records.append(path, [OFF])
    assert records.read(path) == [RIGHT, OFF]


def test_a_stopped_run_does_only_what_is_missing(tmp_path: Path) -> None:
    plan = LocatePlan(1, tuple(positive_cases(3, ["ccs2"])), SHAPES, extras=("auto",))
    first = plan.cases[0].name
    known = [
        replace(RIGHT, case=first),
        replace(RIGHT, case=first, solver="auto"),
        replace(RIGHT, case=plan.cases[1].name),
    ]
    missing = locate_runner._missing(plan, known)
    assert [(task.case.number, task.solvers) for task in missing] == [(1, ("auto",)), (2, ("portdock", "auto"))]


def test_variants_are_asked_about_positive_scans_and_no_prior_about_nominal_ones() -> None:
    plan = LocatePlan(1, (), {}, extras=("no-prior", "auto", "denoised"))
    nominal, hard = (Case("port", 0, tier, "ccs2", "ccs2") for tier in ("nominal", "hard"))
    assert plan.solvers_for(nominal) == ("portdock", "no-prior", "auto", "denoised")
    assert plan.solvers_for(hard) == ("portdock", "auto", "denoised")
    assert plan.solvers_for(Case("plain", 0, "nominal", "ccs2", "ccs2")) == ("portdock", "auto")


def test_a_folder_of_another_seed_is_not_mixed_in(tmp_path: Path) -> None:
    locate_runner._check_plan(LocatePlan(1, (), SHAPES), tmp_path / "plan.json")
    locate_runner._check_plan(LocatePlan(1, tuple(positive_cases(4, ["ccs2"])), SHAPES), tmp_path / "plan.json")
    with pytest.raises(InputError, match="another seed"):
        locate_runner._check_plan(LocatePlan(2, (), SHAPES), tmp_path / "plan.json")


def test_results_become_tables_json_and_one_self_contained_page(tmp_path: Path) -> None:
    cases = positive_cases(1, ["ccs2"])
    plan = LocatePlan(1000, tuple(cases), SHAPES)
    answers = [
        RIGHT,
        OFF,
        replace(RIGHT, kind="dust-cap", case="dust-cap-easy-ccs2-00001"),
        replace(RIGHT, solver="auto"),
    ]
    paths = write_results(answers, plan, tmp_path, ["Skipped: <kiss>"])
    page = write_evaluation_page(tmp_path / "index.html", answers, plan, ["Skipped: <kiss>"]).read_text()
    assert all(path.exists() for path in paths)
    values = json.loads((tmp_path / "summary.json").read_text())
    assert values["false_accepts"] == 2
    assert values["solvers"]["portdock"]["all"]["success"] == pytest.approx(
        {"hits": 1, "n": 2, "low": 0.0126, "high": 0.9874}, abs=1e-3
    )
    assert "&lt;kiss&gt;" in page
    assert "http" not in page.replace("http-equiv", "")
    assert "1/2 = 50.0%" in (tmp_path / "summary.md").read_text()


def test_a_folder_of_scans_is_read_with_its_truth(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.1, 0.1, (500, 3))
    header = (
        "ply\nformat ascii 1.0\nelement vertex 500\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    (tmp_path / "a.ply").write_text(header + "\n".join(" ".join(map(str, row)) for row in points) + "\n")
    truth = {
        "T": np.eye(4).tolist(),
        "prior": np.eye(4).tolist(),
        "port": "ccs2",
        "tier": "hard",
        "crlb": {"trans_mm": 0.1},
    }
    (tmp_path / "a.json").write_text(json.dumps(truth))
    (entry,) = folder_cases(tmp_path)
    assert (entry.case.tier, entry.case.asked, entry.mesh) == ("hard", "ccs2", None)
    assert read_scan(entry).bound_m == pytest.approx(0.0001)


@pytest.mark.parametrize("text", ["{", "[]", '{"T": 1}', '{"T": 1, "prior": 2, "port": "ccs2", "tier": "odd"}'])
def test_a_folder_with_an_unusable_truth_says_so(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    (tmp_path / "a.ply").write_text("")
    with pytest.raises(InputError):
        folder_cases(tmp_path)


def test_a_peer_without_its_library_is_named_and_skipped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    present, notes = _peers("kiss,ppf")
    assert present == ()
    assert "kiss_matcher is not installed" in notes[0]
    with pytest.raises(PeerMissingError):
        PEERS["ppf"].load()


def test_icp_from_a_near_prior_finds_the_port_and_a_pose_beyond_the_prior_is_not_taken() -> None:
    (case,) = positive_cases(1, ["nacs"], ["easy"])
    scan = make_scan(case, 5, SHAPES)
    model = port_model("nacs")
    near = replace(scan, prior=replace(scan.prior, T_ref_port=scan.T_scanner_port.moved([0.0005, 0.0, 0.0])))
    found = peer_pose(PEERS["icp"].load(), near, model)
    assert found.distance_to(scan.T_scanner_port) < 0.0005
    assert not within_prior(Pose.from_rotvec([0, 0, np.pi / 2]), scan.prior)
