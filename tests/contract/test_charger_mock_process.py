"""The mock charger as a program: where it says it listens, how it ends, what it says to bad options."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contract.charger_bench import MockProcess, drain, tap


def _run(*options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mocks.charger", *options]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)


def test_it_takes_its_link_away_when_it_is_told_to_end(tmp_path: Path) -> None:
    mock = MockProcess(tmp_path)
    assert mock.says == {"interface": "slcan", "channel": str(mock.link)}
    assert mock.link.is_symlink()
    assert mock.stop() == 0
    assert not mock.link.is_symlink()


def test_without_options_it_finds_a_place_and_outlives_its_standard_input() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "mocks.charger"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    channel = Path(json.loads(process.stdout.readline())["channel"])
    with tap(channel) as bus:
        assert len(drain(bus, 0.5)) > 5
    process.terminate()
    process.stdout.close()
    assert process.wait(10) == 0
    assert not channel.parent.exists()


def test_a_bad_control_line_changes_nothing(tmp_path: Path) -> None:
    mock = MockProcess(tmp_path)
    mock.control(silnet=True)
    with tap(mock.link) as bus:
        assert drain(bus, 0.5)
    mock.stop()


@pytest.mark.parametrize(
    ("options", "status"),
    [
        (["--link", "/nowhere/at/all"], 3),
        (["--interface", "carrier-pigeon", "--channel", "1"], 3),
        (["--dbc", "/nowhere.dbc"], 2),
        (["--world", "/nowhere"], 2),
        (["--interface", "socketcan"], 2),
    ],
)
def test_options_that_cannot_work_are_one_line(options: list[str], status: int) -> None:
    result = _run(*options)
    assert result.returncode == status
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
