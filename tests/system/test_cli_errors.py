"""What a newcomer sees for bad input: one line of cause, one of remedy, the documented exit code, never a traceback."""

from __future__ import annotations

import json
import os
import pty
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from controller.cli.main import main


def portdock(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> tuple[int, str]:
    """Exit code and what was said."""
    monkeypatch.setattr(sys, "argv", ["portdock", *arguments])
    try:
        main()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    captured = capsys.readouterr()
    return code, captured.out + captured.err


def assert_two_lines(text: str) -> None:
    lines = [line for line in text.strip().splitlines() if line]
    assert len(lines) == 2, text
    assert lines[0].startswith("portdock: ") and lines[1].strip().startswith("remedy: ")
    assert "Traceback" not in text


def site_file(folder: Path, text: str) -> str:
    path = folder / "site.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("arm: {hots: 1.2.3.4}", "unknown key 'arm.hots'"),
        ("scan: {speed_mm_s: 400}", "<= 100 mm/s"),
        ("port: {model: css2}", "'ccs2'"),
        ("arm: [", "line 2"),
        ("scanner: {format: nothing}", "nothing"),
        ("charger: {protection: none}", "docking frames would be unprotected"),
        ("charger: {dbc: /no/such.dbc}", "there is no DBC at /no/such.dbc"),
    ],
)
def test_a_bad_site_file_is_refused_with_exit_code_2(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str, said: str
) -> None:
    code, output = portdock(capsys, monkeypatch, "config", "check", site_file(tmp_path, text + "\n"))
    assert code == 2 and said in output
    assert_two_lines(output)


def test_a_good_site_file_is_said_to_be_good(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    code, output = portdock(capsys, monkeypatch, "config", "check", site_file(tmp_path, "site: bay-7\n"))
    assert code == 0 and "bay-7" in output


def test_an_unknown_scenario_is_a_usage_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    code, output = portdock(capsys, monkeypatch, "dry-run", "--scenario", "rain", "--out", str(tmp_path / "out"))
    assert code == 2 and "nominal" in output
    assert_two_lines(output)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", [["evaluate", "method"], ["evaluate", "calibration"], ["campaign"]])
def test_a_folder_for_results_that_cannot_be_made_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: list[str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    code, output = portdock(capsys, monkeypatch, *command, "--out", str(tmp_path / "file" / "results"))
    assert code == 2 and str(tmp_path / "file") in output
    assert_two_lines(output)


class TestLinksThatCannotBeOpened:
    """``portdock run`` on a site whose devices are not there: exit code 3, and nothing half-written left behind."""

    def run(self, folder: Path, **site: object) -> tuple[int, str]:
        out = folder / "out"
        service = {"socket": str(folder / "s"), "state_folder": str(folder / "state"), "http_port": 0}
        text = json.dumps({**site, "service": service, "recording": {"folder": str(out)}})
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "controller.cli.main",
                "run",
                "--config",
                site_file(folder, text),
            ],
            capture_output=True,
            check=False,
            text=True,
            timeout=110,
            cwd=folder,
        )
        assert done.stdout == ""
        assert not out.exists()
        return done.returncode, done.stderr

    def test_a_can_interface_that_does_not_exist(self, tmp_path: Path) -> None:
        code, said = self.run(tmp_path, charger={"interface": "socketcan", "channel": "can7"})
        assert code == 3 and "can7" in said
        assert_two_lines(said)

    def test_a_can_adapter_that_does_not_exist(self, tmp_path: Path) -> None:
        code, said = self.run(tmp_path, charger={"interface": "slcan", "channel": str(tmp_path / "no-adapter")})
        assert code == 3 and "no-adapter" in said
        assert_two_lines(said)


def test_a_scanner_that_does_not_exist_or_is_taken(tmp_path: Path) -> None:
    from controller.config import load_config
    from controller.wiring import build_devices
    from drivers.base import LinkOpenError, MonotonicClock, NullSink

    def open_scanner(device: str) -> None:
        config = load_config()
        named = config.model_copy(update={"scanner": config.scanner.model_copy(update={"device": device})})
        scanner = build_devices(named, NullSink(), MonotonicClock()).scanner
        scanner.open()
        scanner.close()

    with pytest.raises(LinkOpenError, match="nowhere"):
        open_scanner(str(tmp_path / "nowhere"))
    master, slave = pty.openpty()
    try:
        import serial

        with serial.Serial(os.ttyname(slave), exclusive=True), pytest.raises(LinkOpenError) as caught:
            open_scanner(os.ttyname(slave))
        assert caught.value.remedy
    finally:
        os.close(master)
        os.close(slave)


def test_no_robot_at_the_address(tmp_path: Path) -> None:
    from controller.config import load_config
    from controller.wiring import build_devices
    from drivers.base import LinkOpenError, MonotonicClock, NullSink

    with socket.socket() as nobody:  # bound, not listening: the address is ours and refuses
        nobody.bind(("127.88.7.6", 29999))
        config = load_config()
        named = config.model_copy(update={"arm": config.arm.model_copy(update={"host": "127.88.7.6"})})
        with pytest.raises(LinkOpenError, match=r"127\.88\.7\.6") as caught:
            build_devices(named, NullSink(), MonotonicClock()).arm.open()
    assert caught.value.remedy
