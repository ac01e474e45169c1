"""The drift log: each dock a line, damaged lines left out, a shift warned of on the command line."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.calibrations.dock_log import NAME, append_dock, drift_warnings, judged, read_docks, rest_offset
from controller.calibrations.in_force import basis_of, mock_names, on_mock_cell
from controller.cli.main import app
from controller.config import load_config
from controller.config_section import ConfigError
from controller.faults import Outcome
from controller.mock_calibrations import KEPT_NAME, as_calibrated
from controller.session import log_dock
from controller.task import Goal, Progress
from perception.calibration.drift import Dock
from perception.geometry import Pose

SIGMA = np.array([1e-4] * 3 + [1e-3] * 3)


def write(folder: Path, count: int, shift_m: float = 0.0, basis: str = "a", seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        append_dock(folder, basis, Dock("ccs2", rng.normal(size=6) * SIGMA + [shift_m, 0, 0, 0, 0, 0]))


def test_the_offset_is_actual_minus_expected_in_the_ports_frame() -> None:
    T_base_port = Pose.from_rotvec([0.0, np.pi / 2, 0.0], [1.0, 2.0, 3.0])
    expected = Pose.from_rotvec([np.pi, 0.0, 0.0], [0.0, 0.0, -0.04])
    actual = T_base_port @ Pose.from_rotvec([0.0, 0.0, 0.01]) @ expected.moved([0.0, 0.0, 0.0])
    offset = rest_offset(T_base_port, expected, Pose(actual.rotation, actual.translation + T_base_port.rotation[:, 0]))
    np.testing.assert_allclose(offset, [1.0, 0.0, 0.0, 0.0, 0.0, 0.01], atol=1e-12)


def test_what_is_written_is_read_and_damaged_lines_are_left_out(tmp_path: Path) -> None:
    write(tmp_path, 3)
    with (tmp_path / NAME).open("a") as file:
        file.write(
            '{"time": "2026-01-01T00:00:00+00:00", "basis": "a", "port": "ccs2", "offset_mm_deg": [1, 2]}\n{"ti\n'
        )
    write(tmp_path, 1, basis="b")
    logged = read_docks(tmp_path)
    assert [one.basis for one in logged] == ["a", "a", "a", "b"]
    assert len(judged(logged, "a")) == 3
    first = np.random.default_rng(0).normal(size=6) * SIGMA
    np.testing.assert_allclose(logged[0].dock.offset, first, atol=1e-6)


def test_a_shift_is_warned_of_with_the_command_that_mends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "portdock-calibrations"
    write(folder, 30)
    assert drift_warnings(folder, "a") == ()
    quiet = CliRunner().invoke(app, ["calibrate", "drift"])
    assert quiet.exit_code == 0, quiet.output
    write(folder, 6, shift_m=5e-4, seed=1)
    (warning,) = drift_warnings(folder, "a")
    assert "portdock calibrate hand-eye" in warning
    loud = CliRunner().invoke(app, ["calibrate", "drift", "--out", "chart.png"])
    assert loud.exit_code == 1
    assert "OUT OF BOUNDS" in loud.output
    assert Path("chart.png").stat().st_size > 1000


def test_the_chart_of_plain_dry_runs_proposes_a_correction_to_the_kept_calibrations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "portdock-calibrations"
    cell = on_mock_cell(as_calibrated(load_config()), mock_names(KEPT_NAME))
    write(folder, 30, basis=basis_of(cell))
    write(folder, 6, shift_m=5e-4, basis=basis_of(cell), seed=1)
    shown = CliRunner().invoke(app, ["calibrate", "drift"])
    assert shown.exit_code == 1
    assert "proposed: tool by" in shown.output
    accepted = CliRunner().invoke(app, ["calibrate", "drift", "--accept", "tool"])
    assert accepted.exit_code == 0, accepted.output
    corrected = on_mock_cell(as_calibrated(load_config()), mock_names(KEPT_NAME))
    assert corrected.arm.T_flange_tcp != cell.arm.T_flange_tcp
    assert corrected.scanner.T_flange_scanner == cell.scanner.T_flange_scanner


def test_docks_with_other_calibrations_are_not_judged_together(tmp_path: Path) -> None:
    write(tmp_path, 30)
    write(tmp_path, 6, shift_m=5e-4, basis="b")
    assert drift_warnings(tmp_path, "b") == ()


def test_a_scenario_that_does_not_exist_is_refused_by_name() -> None:
    result = CliRunner().invoke(app, ["calibrate", "drift", "--mock-cell", "0", "--scenario", "nominall"])
    assert isinstance(result.exception, ConfigError)
    assert "no scenario is called 'nominall'" in str(result.exception)


@pytest.mark.parametrize(("kind", "logged"), [("charged", 1), ("charging", 1), ("undocked", 0), ("stopped", 0)])
def test_each_dock_that_led_to_a_charge_is_logged_the_daemons_too(tmp_path: Path, kind: str, logged: int) -> None:
    site = load_config()
    calibration = site.calibration.model_copy(update={"folder": str(tmp_path)})
    site = site.model_copy(update={"calibration": calibration})
    plan: Any = SimpleNamespace(T_base_port=Pose.identity(), T_port_tcp_mated=Pose.identity())
    job = Progress(Goal.DOCK, T_base_tcp_mated=Pose.identity(), plan=plan, outcome=Outcome(kind))  # type: ignore[arg-type]
    log_dock(site, job)
    assert len(read_docks(tmp_path)) == logged


def test_a_log_that_a_power_cut_garbled_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    write(tmp_path, 2)
    with (tmp_path / NAME).open("ab") as file:
        file.write(b"\xff\x00\xfe\n")
    assert len(read_docks(tmp_path)) == 2


def test_a_charge_that_was_found_is_no_dock(tmp_path: Path) -> None:
    site = load_config()
    calibration = site.calibration.model_copy(update={"folder": str(tmp_path)})
    log_dock(site.model_copy(update={"calibration": calibration}), Progress(Goal.RESET, outcome=Outcome("charging")))
    assert not read_docks(tmp_path)
