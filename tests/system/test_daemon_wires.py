"""The daemon over real wires: killed with the plug locked in the port; its scanner unplugged within a sweep."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from controller.campaign.faulty_cell import FaultyCell
from controller.cli.dry_run import FAST_FACTOR, for_mocks
from controller.config import as_yaml, load_config
from controller.daemon.client import DaemonClient
from controller.daemon.protocol import Request
from controller.port_files import load_port
from controller.recording.reader import read_recording
from controller.replay.replay import replay
from controller.scenarios import draw_scenario

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]

PORTDOCK = [sys.executable, "-m", "controller.cli.main"]


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[FaultyCell]:
    """Mock devices that outlive the daemon."""
    wide = for_mocks(load_config(), fast=True)
    service = {"socket": str(tmp_path / "s"), "state_folder": str(tmp_path / "state"), "http_port": 0}
    changes = {"service": service, "recording": {"folder": str(tmp_path / "runs")}}
    wide = wide.model_copy(update={k: getattr(wide, k).model_copy(update=v) for k, v in changes.items()})
    world = draw_scenario("nominal", wide, load_port(wide.port.model), 4)
    with FaultyCell(tmp_path / "wires", wide, world, 4, FAST_FACTOR) as cell:
        yield cell


@pytest.fixture
def site(tmp_path: Path, cell: FaultyCell) -> Path:
    """Their site file."""
    path = tmp_path / "site.yaml"
    path.write_text(as_yaml(cell.config))
    return path


def start(site: Path) -> subprocess.Popen[bytes]:
    command = [*PORTDOCK, "run", "--config", str(site), "--pace", f"{FAST_FACTOR:g}"]
    with (site.parent / "daemon.log").open("ab") as log:
        daemon = subprocess.Popen(command, stdout=log, stderr=log, cwd=site.parent)
    end_s = time.monotonic() + 120.0
    while time.monotonic() < end_s:
        assert daemon.poll() is None, (site.parent / "daemon.log").read_text()
        if (site.parent / "s").exists() and ask(site, "status")[1].get("state") in ("READY", "CHARGING", "FAULT"):
            return daemon
        time.sleep(0.2)
    raise AssertionError((site.parent / "daemon.log").read_text())


def ask(site: Path, *words: str) -> tuple[int, dict]:  # type: ignore[type-arg]
    done = subprocess.run(
        [*PORTDOCK, *words, "--json", "--socket", str(site.parent / "s")],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    return done.returncode, json.loads(done.stdout or "{}")


def test_a_daemon_killed_while_charging_comes_up_safe_and_undocks_when_asked(site: Path) -> None:
    first = start(site)
    code, docked = ask(site, "dock")
    assert (code, docked["outcome"]) == (0, "charging"), docked
    assert ask(site, "dock")[1]["outcome"] == "already-docked"
    first.send_signal(signal.SIGKILL)
    first.wait()
    second = start(site)
    try:
        code, status = ask(site, "status")
        assert status["plug"] == "LATCHED" and status["lock"] == "LOCKED"
        if status["state"] == "FAULT":  # the charger has ended the charge by itself, as its supervision demands
            assert code == 1 and status["fault"] == "plug-inserted-at-start" and "undock" in status["remedy"]
        code, undocked = ask(site, "undock")
        assert (code, undocked["outcome"]) == (0, "undocked"), undocked
        status = ask(site, "status")[1]
        assert (status["state"], status["plug"], status["lock"]) == ("READY", "ABSENT", "UNLOCKED")
        recordings = [read_recording(path) for path in sorted((site.parent / "runs").glob("*/mission.mcap"))]
        assert [one.complete for one in recordings] == [True, True]
        for recorded, last in zip(recordings, ("CHARGING", "READY"), strict=True):
            again = replay(recorded, recorded_estimates=True)
            assert again.difference is None and again.states[-1] == last, f"{again.difference} {again.ended}"
    finally:
        second.send_signal(signal.SIGTERM)
        assert second.wait(60) == 0


def profiles_of_a_sweep(client: DaemonClient) -> int:
    """Good frames so far, while the daemon sweeps; else 0."""
    status = client.ask(Request.STATUS).status or {}
    return int(status["links"]["scanner"]["counters"]["frames"]) if status["state"] == "SCANNING" else 0


def test_a_scanner_unplugged_in_the_middle_of_a_sweep_docks_after_a_reset_under_another_name(
    site: Path, cell: FaultyCell
) -> None:
    daemon, name = start(site), site.parent / "wires" / "scanner"
    try:
        before, socket = os.readlink(name), site.parent / "s"
        job = subprocess.Popen(
            [*PORTDOCK, "dock", "--json", "--socket", str(socket)], stdout=subprocess.PIPE, text=True
        )
        with DaemonClient(socket) as client:
            until(lambda: profiles_of_a_sweep(client) > 30, "the sweep is under way")
        cell.unplug_scanner()
        output, _ = job.communicate(timeout=120)
        ended = json.loads(output)
        assert (job.returncode, ended["fault"]) == (1, "scanner-link-lost"), ended
        assert "cable" in ended["remedy"]
        assert ask(site, "status")[1]["links"]["scanner"]["up"] is False
        (left,) = (read_recording(path) for path in (site.parent / "runs").glob("*/mission.mcap"))
        assert left.complete and left.scanner_chunks(), "what came until then is kept"
        cell.repair()
        until(lambda: name.exists() and os.readlink(name) != before, "the scanner is back under another name")
        assert ask(site, "reset")[0] == 0
        code, docked = ask(site, "dock")
        assert (code, docked["outcome"]) == (0, "charging"), docked
    finally:
        daemon.send_signal(signal.SIGTERM)
        daemon.wait(60)


def until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + 200.0
    while not condition():
        assert time.monotonic() < end_s, what
        time.sleep(0.02)
