"""Other people's programs on our bus: can-utils and cantools' own command line see what we say, and are understood.

What they decode comes from the bundled DBC alone, as a charger's supplier would read it.
"""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.base import ChargerState, MonotonicClock
from drivers.charger.can_charger import CanCharger
from drivers.charger.contract import bundled_dbc
from drivers.charger.settings import CanSettings
from mocks.charger.frames import Frames
from mocks.charger.node import ChargerNode
from tests.contract.charger_bench import Bench, MockProcess

pytestmark = pytest.mark.skipif(
    shutil.which("candump") is None, reason="can-utils are not installed: make setup-socketcan"
)
SCREEN_S = 60.0


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    mock = MockProcess(tmp_path, "--lost-ms=5000", "--time-scale=10")
    bench = Bench(mock, degraded_s=3.0, lost_s=5.0, open_timeout_s=20.0)
    bench.welcome()
    yield bench
    bench.close()
    mock.stop()


def _candump(bench: Bench, *options: str, frames: int = 60) -> str:
    command = ["candump", "-n", str(frames), *options, bench.settings.channel]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as dump:
        bench.until(lambda: dump.poll() is not None, 30.0)
        assert dump.stdout is not None
        return dump.stdout.read()


def test_candump_sees_both_sides(bench: Bench) -> None:
    text = _candump(bench, "-L")
    assert " 0CFF10B0#" in text
    assert " 0CFF2056#" in text


def test_cantools_decodes_what_candump_saw(bench: Bench) -> None:
    command = [sys.executable, "-m", "cantools", "decode", "--single-line", str(bundled_dbc())]
    decoded = subprocess.run(command, input=_candump(bench), capture_output=True, text=True, check=True).stdout
    assert re.search(r"RC_Heartbeat\(.*Mode: .?Auto", decoded), decoded
    assert re.search(r"CH_Status\(.*State: .?Idle", decoded), decoded


def test_cantools_monitor_shows_our_traffic(bench: Bench) -> None:
    command = [sys.executable, "-m", "cantools", "monitor", "-i", "socketcan", "-c", bench.settings.channel]
    screen = _screen(bench, [*command, str(bundled_dbc())], lambda text: "CH_Status" in text and "RC_Heartbeat" in text)
    assert "Idle" in screen


def test_a_charger_played_by_cansend_is_understood() -> None:
    frames, node = Frames(None, "e2e-p11"), ChargerNode()
    sent = [frames.encode("CH_Status", node.status()) for _ in range(300)]
    lines = "".join(f"{frame.identifier:08X}#{frame.data.hex().upper()}\n" for frame in sent)
    settings = CanSettings(interface="socketcan", channel="vcan0", degraded_s=3.0, lost_s=5.0, open_timeout_s=30.0)
    charger = CanCharger(settings, MonotonicClock())
    loop = ["sh", "-c", "while read frame; do cansend vcan0 $frame; done"]
    with subprocess.Popen(loop, stdin=subprocess.PIPE, text=True) as player:
        assert player.stdin is not None
        player.stdin.write(lines)
        player.stdin.close()
        try:
            charger.open()
            assert charger.status().state is ChargerState.INIT
            assert dict(charger.health().counters)["bad_checksum"] == 0
        finally:
            player.kill()
            charger.close()


def _screen(bench: Bench, command: list[str], enough: Callable[[str], bool]) -> str:
    """What a program has drawn on its terminal by the time that it is enough."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ |= {"TERM": "linux", "COLUMNS": "200", "LINES": "60"}
        os.execv(command[0], command)
    text, end_s = "", time.monotonic() + SCREEN_S
    try:
        while not enough(text):
            assert time.monotonic() < end_s, text
            bench.tick()
            if select.select([terminal], [], [], 0.01)[0]:
                text += os.read(terminal, 65536).decode(errors="replace")
    finally:
        os.kill(pid, 15)
        os.waitpid(pid, 0)
        os.close(terminal)
    return text
