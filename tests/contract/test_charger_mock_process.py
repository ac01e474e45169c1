"""The mock charger as a program: where it says it listens, how it ends, what it says to bad options."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tty
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


def test_it_takes_a_slcan_adapter_that_is_there_for_its_bus() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    channel = os.ttyname(slave)
    command = [sys.executable, "-m", "mocks.charger", "--interface", "slcan", "--channel", channel]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    try:
        said = b""
        while said.count(b"T0CFF20568") < 3:  # CH_Status, eight bytes
            said += os.read(master, 4096)
        assert b"S5\r" in said, "250 kbit/s"
        assert process.stdout is not None
        assert json.loads(process.stdout.readline()) == {"interface": "slcan", "channel": channel}
    finally:
        process.terminate()
        process.wait(10)
        os.close(master)
        os.close(slave)


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
        (["--interface", "slcan", "--channel", "/dev/none"], 3),
    ],
)
def test_options_that_cannot_work_are_one_line(options: list[str], status: int) -> None:
    result = _run(*options)
    assert result.returncode == status
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
