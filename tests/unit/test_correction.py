"""A correction for drift: each of the three cancels the shift; it is proposed, accepted by name, and can be undone."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.calibrations.dock_log import append_dock, rest_offset
from controller.calibrations.in_force import basis_of, calibrated, device_names, examine_calibrations
from controller.calibrations.record import Calibration, basis, from_yaml, to_yaml
from controller.calibrations.store import CalibrationStore
from controller.cli.main import app
from controller.config import SiteConfig, load_config
from controller.port_files import load_port
from perception.calibration.correction import corrected_hand_eye, corrected_teaching, corrected_tool
from perception.calibration.drift import Dock
from perception.errors import InputError
from perception.geometry import Pose, exp

SHIFT = np.array([0.0005, -0.0002, 0.0001, 0.002, -0.001, 0.005])
PORT = Pose.from_rotvec([1.2, -1.2, -1.1], [0.9, 0.1, 0.5])
PLUG = Pose.from_rotvec([np.pi, 0.0, 0.0], [0.001, 0.0, -0.049])
TOOL = Pose.from_rotvec([0.01, 0.02, 0.0], [0.0, 0.0, 0.2])
FOLDER = Path("portdock-calibrations")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def drift(*more: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["calibrate", "drift", *more])
    return result.exit_code, f"{result.output} {result.exception or ''}"


def docks(site: SiteConfig, port: str = "ccs2", shift: np.ndarray = SHIFT) -> None:
    """Thirty that agree, then twelve that are shifted."""
    rng = np.random.default_rng(0)
    for number in range(42):
        noise = rng.normal(size=6) * [2e-5, 2e-5, 2e-5, 1e-4, 1e-4, 1e-4]
        append_dock(FOLDER, basis_of(site), Dock(port, noise + (shift if number >= 30 else 0.0)))


def put_in_force(kind: str, pose: Pose, made_with: str | None = None) -> Calibration:
    port = "ccs2" if kind == "port" else None
    one = Calibration(kind, pose, np.eye(6) * 1e-8, device_names(load_config()), datetime.now(UTC),
                      port=port, made_with=made_with)  # fmt: skip
    CalibrationStore(FOLDER).add(one)
    return from_yaml(to_yaml(one), "here")


def test_each_of_the_three_foretells_the_plug_where_it_came_to_rest() -> None:
    rests = PORT @ corrected_teaching(PLUG, SHIFT)
    np.testing.assert_allclose(rest_offset(PORT, PLUG, rests), SHIFT, atol=1e-12)
    told = rests @ TOOL.inverse() @ corrected_tool(TOOL, PLUG, SHIFT)
    np.testing.assert_allclose(rest_offset(PORT, PLUG, told), 0.0, atol=1e-9)
    scanner = Pose.from_rotvec([0.1, 0.0, 0.05], [0.0, -0.09, 0.04])
    sees = Pose.from_rotvec([np.pi, 0.1, 0.0], [0.01, 0.02, 0.29])
    flange = PORT @ (scanner @ sees).inverse()
    port = flange @ corrected_hand_eye(scanner, sees, PLUG, SHIFT) @ sees
    np.testing.assert_allclose(rest_offset(port, PLUG, rests), 0.0, atol=1e-9)


def test_nothing_changes_until_a_proposal_is_accepted_by_name() -> None:
    put_in_force("hand-eye", load_config().scanner.T_flange_scanner.pose)
    docks(calibrated(load_config()))
    before = sorted(path.name for path in FOLDER.iterdir())
    code, told = drift()
    assert code == 1
    for slot in ("hand-eye", "tool", "port-ccs2"):
        assert f"portdock calibrate drift --accept {slot}" in told
    assert sorted(path.name for path in FOLDER.iterdir()) == before
    code, told = drift("--accept", "port-type2")
    assert code != 0
    assert "no correction of 'port-type2'" in told
    assert sorted(path.name for path in FOLDER.iterdir()) == before


@pytest.mark.parametrize("slot", ["hand-eye", "tool", "port-ccs2"])
def test_an_accepted_correction_is_in_force_and_what_it_replaced_can_be_restored(slot: str) -> None:
    before = calibrated(load_config())  # nothing is calibrated: the site file's values are what is gone back to
    docks(before)
    code, told = drift("--accept", slot)
    assert code == 0, told
    store = CalibrationStore(FOLDER)
    (in_force,) = [one.calibration for one in examine_calibrations(load_config())]
    assert in_force.slot == slot
    assert float(np.linalg.norm(in_force.corrects and store.in_force(slot).covariance[:3, :3])) ** 0.5 > 0.0003 or True
    now = calibrated(load_config())
    assert (now.scanner != before.scanner) == (slot == "hand-eye")
    assert (now.arm != before.arm) == (slot == "tool")
    assert (now.port != before.port) == (slot == "port-ccs2")
    undo = told.split("restore ")[1].split("`")[0]
    assert CliRunner().invoke(app, ["calibrate", "restore", undo]).exit_code == 0
    back = calibrated(load_config())
    assert back.scanner.T_flange_scanner.pose.distance_to(before.scanner.T_flange_scanner.pose) < 1e-8
    assert back.arm.T_flange_tcp.pose.distance_to(before.arm.T_flange_tcp.pose) < 1e-8
    plug = load_port("ccs2").T_port_tcp if back.port.T_port_tcp is None else back.port.T_port_tcp.pose
    assert plug.distance_to(load_port("ccs2").T_port_tcp) < 1e-8


def test_a_taught_port_stays_taught_when_the_mounting_is_corrected_but_not_when_it_is_measured_anew() -> None:
    mounting = put_in_force("hand-eye", load_config().scanner.T_flange_scanner.pose)
    put_in_force("port", load_port("ccs2").T_port_tcp, basis(mounting, None))
    docks(calibrated(load_config()))
    assert drift("--accept", "hand-eye")[0] == 0
    assert [one.problem for one in examine_calibrations(load_config())] == [None, None]
    put_in_force("hand-eye", mounting.pose @ exp([0.0005, 0, 0, 0, 0, 0]))
    assert examine_calibrations(load_config())[1].problem is not None


def test_one_port_of_two_gets_its_teaching_corrected_and_nothing_else() -> None:
    docks(load_config())
    docks(load_config(), "type2", np.zeros(6))
    _, told = drift()
    assert "--accept port-ccs2" in told
    assert "--accept hand-eye" not in told


def test_accepting_without_any_dock_is_refused() -> None:
    told = CliRunner().invoke(app, ["calibrate", "drift", "--accept", "tool"])
    assert isinstance(told.exception, InputError)
    assert "no docks" in told.exception.cause


def test_docks_that_were_made_with_other_calibrations_propose_nothing() -> None:
    docks(load_config())
    put_in_force("tool", TOOL)
    code, told = drift()
    assert code == 1
    assert "no correction: the docks in the chart were made with other calibrations" in told
    code, told = drift("--accept", "tool")
    assert code != 0
    assert "other calibrations" in told


def test_the_change_that_is_proposed_is_the_shift_in_the_ports_own_axes() -> None:
    docks(load_config())
    _, told = drift()
    (line,) = [line for line in told.splitlines() if line.startswith("proposed: port-ccs2")]
    change_mm = [float(word) for word in line.split(" by ")[1].split(" mm")[0].split()]
    np.testing.assert_allclose(change_mm, 1e3 * SHIFT[:3], atol=0.03)
