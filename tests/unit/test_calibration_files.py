"""Calibration files: written whole, kept, refused when damaged, foreign or old; what a site becomes with them."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.calibrations import store as store_module
from controller.calibrations.in_force import (
    basis_of,
    calibrated,
    device_names,
    examine_calibrations,
    mock_names,
    on_mock_cell,
    with_calibrations,
)
from controller.calibrations.record import Calibration, CalibrationFileError, DeviceNames, basis, from_yaml, to_yaml
from controller.calibrations.store import CalibrationStore
from controller.cli.main import app
from controller.config import SiteConfig, load_config
from controller.doctor.examination import calibrations
from controller.doctor.findings import Grade
from controller.mock_calibrations import cell_name
from perception.geometry import Pose

NOW = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)


def site(folder: Path) -> SiteConfig:
    base = load_config()
    return base.model_copy(update={"calibration": base.calibration.model_copy(update={"folder": str(folder)})})


def hand_eye(config: SiteConfig, x_mm: float = 5.0, measured: datetime = NOW) -> Calibration:
    pose = Pose.from_rotvec([0.1, 0.02, -3.0], [x_mm / 1e3, -0.09, 0.04])
    sigma = np.diag([1e-5] * 3 + [2e-4] * 3) ** 2
    residuals = (("rms_mm", 0.1),)
    return Calibration("hand-eye", pose, sigma, device_names(config), measured, residuals, latency_ms=3.5)


def test_a_file_gives_back_what_was_written(tmp_path: Path) -> None:
    written = hand_eye(site(tmp_path))
    read = from_yaml(to_yaml(written), "a file")
    assert read.pose.distance_to(written.pose) < 1e-8
    assert read.pose.angle_to(written.pose) < 1e-8
    np.testing.assert_allclose(read.covariance, written.covariance, rtol=1e-6)
    assert (read.latency_ms, read.devices, read.measured) == (3.5, written.devices, NOW)
    assert dict(read.residuals) == {"rms_mm": 0.1}


ARM_ERRORS = np.concatenate([np.linspace(-2e-4, 2e-4, 12), np.deg2rad(np.linspace(-0.02, 0.02, 6)), [3e-6]])


def test_the_arms_errors_are_kept_in_their_units_and_become_the_sites(tmp_path: Path) -> None:
    config = site(tmp_path)
    text = to_yaml(replace(hand_eye(config), arm_errors=ARM_ERRORS))
    assert "a_mm: [-0.2, -0.163636," in text
    assert "compliance_urad_per_nm: 3.0" in text
    read = from_yaml(text, "a file")
    np.testing.assert_allclose(read.arm_errors, ARM_ERRORS, atol=2e-9)
    effective = with_calibrations(config, [read])
    np.testing.assert_allclose(effective.arm.errors.errors, ARM_ERRORS, atol=2e-9)
    assert basis_of(effective) != basis_of(with_calibrations(config, [hand_eye(config)]))


def test_a_calibration_without_the_arms_errors_leaves_the_arm_at_its_word(tmp_path: Path) -> None:
    config = site(tmp_path)
    assert from_yaml(to_yaml(hand_eye(config)), "a file").arm_errors is None
    assert with_calibrations(config, [hand_eye(config)]).arm.errors.errors is None


@pytest.mark.parametrize(
    "wrong", ["a_mm: [0.1]", "a_mm: [0.1, 0, 0, .nan, 0, 0]", "b_mm: []", "a_mm: [9, 0, 0, 0, 0, 0]"]
)
def test_errors_of_the_arm_that_no_arm_has_are_no_calibration(tmp_path: Path, wrong: str) -> None:
    text = to_yaml(replace(hand_eye(site(tmp_path)), arm_errors=ARM_ERRORS))
    damaged = text.replace(text[text.index("a_mm") : text.index("]", text.index("a_mm")) + 1], wrong)
    with pytest.raises(CalibrationFileError, match="no calibration file"):
        from_yaml(damaged, "a file")


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text.replace("5.0", "6.0", 1),
        lambda text: text[: len(text) // 2],
        lambda text: text.replace("kind: hand-eye", "kind: other"),
        lambda text: "",
        lambda text: "[1, 2]",
    ],
)
def test_a_file_that_was_edited_or_cut_short_is_refused(tmp_path: Path, damage) -> None:
    text = to_yaml(hand_eye(site(tmp_path)))
    assert damage(text) != text
    with pytest.raises(CalibrationFileError):
        from_yaml(damage(text), "a file")


def test_the_newest_is_in_force_the_older_is_kept_and_can_be_restored(tmp_path: Path) -> None:
    config, store = site(tmp_path), CalibrationStore(tmp_path)
    first = store.add(hand_eye(config, 1.0))
    store.add(hand_eye(config, 2.0))  # within the same second
    assert len(store.files("hand-eye")) == 2
    assert store.in_force("hand-eye").pose.translation[0] == pytest.approx(0.002)
    store.restore(Path(first.name))
    assert store.in_force("hand-eye").pose.translation[0] == pytest.approx(0.001)
    assert len(store.files("hand-eye")) == 2


def test_a_calibration_that_is_interrupted_leaves_the_old_one_in_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, store = site(tmp_path), CalibrationStore(tmp_path)
    store.add(hand_eye(config, 1.0))
    real, calls = store_module.write_durably, []

    def dies(path: Path, text: str) -> None:
        calls.append(path.name)
        if path.name.endswith(".in-force"):
            raise KeyboardInterrupt
        real(path, text)

    monkeypatch.setattr(store_module, "write_durably", dies)
    with pytest.raises(KeyboardInterrupt):
        store.add(hand_eye(config, 2.0, NOW + timedelta(days=1)))
    assert calls[-1] == "hand-eye.in-force"
    assert store.in_force("hand-eye").pose.translation[0] == pytest.approx(0.001)


def test_the_site_becomes_what_its_calibrations_say(tmp_path: Path) -> None:
    config = site(tmp_path)
    one = hand_eye(config)
    port = Calibration("port", Pose.from_rotvec([np.pi, 0, 0], [0, 1e-4, -0.04]), one.covariance, one.devices, NOW,
                       port="ccs2", made_with=basis(one, None))  # fmt: skip
    tool = replace(one, kind="tool", latency_ms=None)
    result = with_calibrations(config, [one, port, tool])
    assert result.scanner.T_flange_scanner.pose.distance_to(one.pose) < 1e-9
    assert result.scanner.latency_ms == 3.5
    assert result.arm.T_flange_tcp.pose.distance_to(one.pose) < 1e-9
    assert result.port.T_port_tcp.pose.distance_to(port.pose) < 1e-9
    assert result.port.T_port_tcp.pose.angle_to(port.pose) < 1e-7
    assert with_calibrations(config, []) == config


def test_other_devices_and_old_age_are_refused_by_name(tmp_path: Path) -> None:
    config = site(tmp_path)
    CalibrationStore(tmp_path).add(hand_eye(config, measured=datetime.now(UTC)))
    assert calibrated(config).scanner.latency_ms == 3.5
    other = config.model_copy(update={"scanner": config.scanner.model_copy(update={"serial": "S2"})})
    with pytest.raises(CalibrationFileError, match="not S2"):
        calibrated(other)
    (old,) = examine_calibrations(config, now=datetime.now(UTC) + timedelta(days=181))
    assert "181 days old" in old.problem.cause


def named(scenario: str, cell: int | None) -> DeviceNames:
    return mock_names(cell_name(load_config(), scenario, 0, cell))


@pytest.mark.parametrize(("scenario", "used"), [("uncalibrated", True), ("nominal", False), ("blocked", False)])
def test_what_was_measured_on_an_uncalibrated_mock_cell_is_for_no_other_with_its_number(
    tmp_path: Path, scenario: str, used: bool
) -> None:
    config = site(tmp_path)
    one = replace(hand_eye(config), devices=named("uncalibrated", 3), measured=datetime.now(UTC))
    CalibrationStore(Path(config.calibration.folder)).add(one)
    found = on_mock_cell(config, named(scenario, 3))
    assert (found.scanner.T_flange_scanner != config.scanner.T_flange_scanner) is used
    assert on_mock_cell(config, named("nominal", None)).scanner.T_flange_scanner == config.scanner.T_flange_scanner
    assert on_mock_cell(config, named(scenario, 4)).scanner.T_flange_scanner == config.scanner.T_flange_scanner


def test_a_port_taught_with_another_hand_eye_is_to_be_taught_again(tmp_path: Path) -> None:
    config, store = site(tmp_path), CalibrationStore(tmp_path)
    one = hand_eye(config, measured=datetime.now(UTC))
    store.add(one)
    taught = replace(one, kind="port", port="ccs2", latency_ms=None, made_with=basis(from_yaml(to_yaml(one), ""), None))
    store.add(taught)
    assert [found.problem for found in examine_calibrations(config)] == [None, None]
    store.add(hand_eye(config, 9.0, datetime.now(UTC)))
    (_, port) = examine_calibrations(config)
    assert "made with hand-eye" in port.problem.cause


def test_a_tool_found_by_mating_goes_with_its_hand_eye_and_a_touched_one_with_any(tmp_path: Path) -> None:
    config, store = site(tmp_path), CalibrationStore(tmp_path)
    one = hand_eye(config, measured=datetime.now(UTC))
    store.add(one)
    touched = replace(one, kind="tool", latency_ms=None)
    mated = replace(touched, made_with=basis(from_yaml(to_yaml(one), ""), None))
    store.add(hand_eye(config, 9.0, datetime.now(UTC)))
    store.add(touched)
    assert [found.problem for found in examine_calibrations(config)] == [None, None]
    store.add(mated)
    (_, tool) = examine_calibrations(config)
    assert "portdock calibrate tcp" in tool.problem.remedy
    with pytest.raises(CalibrationFileError, match="the tool calibration was made with"):
        calibrated(config)
    left_aside = calibrated(config, remade=("tool",))
    assert left_aside.arm == config.arm
    assert left_aside.scanner.latency_ms == 3.5


def test_the_doctor_tells_of_missing_ageing_and_refused_calibrations(tmp_path: Path) -> None:
    config = site(tmp_path)
    assert [finding.grade for finding in calibrations(config)] == [Grade.WARN]
    CalibrationStore(tmp_path).add(hand_eye(config))
    ages = [(30, Grade.OK), (150, Grade.WARN), (200, Grade.FAIL)]
    for days, grade in ages:
        (finding,) = calibrations(config, NOW + timedelta(days=days))
        assert finding.grade is grade, finding
        assert grade is Grade.OK or finding.fix


def test_show_compare_and_restore_as_a_user_calls_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runner, folder = CliRunner(), tmp_path / "portdock-calibrations"
    assert "no calibration" in runner.invoke(app, ["calibrate", "show"]).output
    store, config = CalibrationStore(folder), load_config()
    old = store.add(hand_eye(config, 5.0))
    new = store.add(hand_eye(config, 6.0, NOW + timedelta(days=1)))
    shown = runner.invoke(app, ["calibrate", "show"]).output
    assert new.name in shown
    assert "kept: " + old.name in shown
    told = runner.invoke(app, ["calibrate", "compare", old.name]).output
    assert "moved by 1.000 mm" in told
    assert "the mounting moved" in told
    assert runner.invoke(app, ["calibrate", "restore", old.name]).exit_code == 0
    assert old.name in runner.invoke(app, ["calibrate", "show"]).output.splitlines()[0]
