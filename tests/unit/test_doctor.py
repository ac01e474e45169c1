"""What the doctor says of a computer and its links; every complaint comes with a fix."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import socket
from importlib import metadata
from pathlib import Path

import pytest
from typer.testing import CliRunner

from controller.cli.main import app
from controller.config import load_config, parse_config
from controller.doctor import devices, host
from controller.doctor.examination import contract, port
from controller.doctor.findings import Finding, Grade


def grades(findings: list[Finding]) -> list[Grade]:
    return [finding.grade for finding in findings]


@pytest.fixture
def tty():
    ours, theirs = pty.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_an_interpreter_without_wheels_fails() -> None:
    assert host.python((3, 12)).grade is Grade.OK
    assert host.python((3, 13)).grade is Grade.FAIL


def test_a_missing_library_fails_and_a_missing_compiler_only_warns() -> None:
    def version_of(name: str) -> str:
        if name in ("ur-rtde", "numba"):
            raise metadata.PackageNotFoundError(name)
        return "1.0"

    found = {finding.text.split()[0]: finding.grade for finding in host.libraries(version_of)}
    assert found["ur-rtde"] is Grade.FAIL
    assert found["numba"] is Grade.WARN
    assert found["numpy"] is Grade.OK


def test_a_disk_with_less_room_than_is_kept_warns_and_a_file_in_place_of_the_folder_fails(tmp_path: Path) -> None:
    assert host.disk(tmp_path / "runs", 1.0).grade is Grade.OK
    assert host.disk(tmp_path / "runs", 1e12).grade is Grade.WARN
    (tmp_path / "file").touch()
    assert host.disk(tmp_path / "file", 1.0).grade is Grade.FAIL
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.parametrize(("late_s", "grade"), [(0.001, Grade.OK), (0.02, Grade.WARN), (0.2, Grade.FAIL)])
def test_scheduling_is_graded_by_how_late_sleeps_end(late_s: float, grade: Grade) -> None:
    assert host.scheduling(lambda: late_s).grade is grade


def test_a_saving_governor_warns(tmp_path: Path) -> None:
    file = tmp_path / "cpu0" / "cpufreq" / "scaling_governor"
    file.parent.mkdir(parents=True)
    file.write_text("powersave\n")
    assert host.governor(tmp_path).grade is Grade.WARN
    file.write_text("performance\n")
    assert host.governor(tmp_path).grade is Grade.OK


def test_a_clock_that_stands_at_the_epoch_fails(tmp_path: Path) -> None:
    assert host.clock(tmp_path / "none", now_s=0.0).grade is Grade.FAIL
    assert host.clock(tmp_path / "none").grade is Grade.WARN
    assert host.clock(tmp_path).grade is Grade.OK


def test_a_free_serial_device_is_fine(tty: str) -> None:
    assert grades(devices.serial_device("scanner", tty)) == [Grade.OK]


def test_a_serial_device_that_another_holds_is_taken(tty: str) -> None:
    with open(tty, "r+b", buffering=0) as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        (finding,) = devices.serial_device("scanner", tty)
    assert finding.grade is Grade.FAIL
    assert "taken" in finding.text


def test_a_serial_device_that_is_missing_or_none_fails(tmp_path: Path) -> None:
    assert grades(devices.serial_device("scanner", str(tmp_path / "none"))) == [Grade.FAIL]
    (tmp_path / "file").touch()
    assert grades(devices.serial_device("scanner", str(tmp_path / "file"))) == [Grade.FAIL]


@pytest.mark.parametrize(("value", "grade"), [("16\n", Grade.WARN), ("1\n", Grade.OK)])
def test_an_adapter_that_holds_bytes_back_is_named(tty: str, tmp_path: Path, value: str, grade: Grade) -> None:
    timer = tmp_path / "class" / "tty" / Path(tty).name / "device" / "latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text(value)
    assert grades(devices.serial_device("scanner", tty, tmp_path)) == [Grade.OK, grade]


@pytest.mark.parametrize(("flags", "grade"), [("0x1003", Grade.OK), ("0x1002", Grade.FAIL)])
def test_a_can_network_must_be_up(tmp_path: Path, flags: str, grade: Grade) -> None:
    folder = tmp_path / "class" / "net" / "can0"
    folder.mkdir(parents=True)
    (folder / "flags").write_text(flags)
    assert devices.network("charger", "can0", tmp_path).grade is grade
    assert devices.network("charger", "can1", tmp_path).grade is Grade.FAIL


@pytest.mark.parametrize(
    ("charger", "grade"),
    [
        ({}, Grade.OK),
        ({"protection": "none", "accept_unprotected_can": True}, Grade.WARN),
        ({"protection": "none"}, Grade.FAIL),
        ({"dbc": "/no/such.dbc"}, Grade.FAIL),
    ],
)
def test_the_contract_must_be_usable_and_frames_without_protection_are_told(charger: dict, grade: Grade) -> None:
    assert contract(parse_config({"charger": charger})).grade is grade


def test_each_port_of_the_robot_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        with socket.create_server(("127.0.0.1", 0)) as gone:
            closed = gone.getsockname()[1]
        monkeypatch.setattr(devices, "ARM_PORTS", ((server.getsockname()[1], "RTDE"), (closed, "dashboard")))
        assert grades(devices.arm(parse_config({"arm": {"host": "127.0.0.1"}}))) == [Grade.OK, Grade.FAIL]


def test_a_port_known_from_memory_is_to_be_checked_first() -> None:
    assert port(parse_config({"port": {"model": "ccs2"}})).grade is Grade.OK
    assert port(parse_config({"port": {"model": "nacs"}})).grade is Grade.WARN


def test_every_complaint_of_the_command_has_a_fix_and_a_missing_device_makes_it_exit_1(tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text(
        "arm: {host: 127.0.0.1}\nscanner: {device: /dev/none}\nrecording: {folder: " + str(tmp_path) + "}\n"
    )
    assert load_config(site).scanner.device == "/dev/none"
    result = CliRunner().invoke(app, ["doctor", "--config", str(site), "--json"])
    findings = [json.loads(line) for line in result.stdout.splitlines()]
    assert result.exit_code == 1
    assert [one for one in findings if one["grade"] != "ok" and not one["fix"]] == []
    assert any("/dev/none does not exist" in one["text"] for one in findings)
