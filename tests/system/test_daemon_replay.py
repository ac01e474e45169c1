"""Each job of a daemon is a recording that replays, however the scanner is synchronised and whatever began the job."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from controller.campaign.faulty_cell import FaultyCell
from controller.cli.dry_run import FAST_FACTOR, for_mocks
from controller.config import as_yaml, load_config
from controller.port_files import load_port
from controller.recording.reader import read_recording
from controller.replay.replay import replay
from controller.scenarios import draw_scenario
from tests.system.test_daemon_wires import ask, start

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]

JOBS = (("dock", "charging"), ("undock", "undocked"), ("dock", "charging"), ("stop", "stopped"))


@pytest.mark.parametrize("sync", ["timestamp", "shared_clock", "trigger", "stop_and_go"])
def test_every_job_of_a_daemon_replays(tmp_path: Path, sync: str) -> None:
    wide = for_mocks(load_config(), fast=True)
    service = {"socket": str(tmp_path / "s"), "state_folder": str(tmp_path / "state"), "http_port": 0}
    changes = {"service": service, "recording": {"folder": str(tmp_path / "runs")}, "scanner": {"sync": sync}}
    wide = wide.model_copy(update={k: getattr(wide, k).model_copy(update=v) for k, v in changes.items()})
    world = draw_scenario("nominal", wide, load_port(wide.port.model), 4)
    with FaultyCell(tmp_path / "wires", wide, world, 4, FAST_FACTOR) as cell:
        site = tmp_path / "site.yaml"
        site.write_text(as_yaml(cell.config))
        daemon = start(site)
        try:
            outcomes = [ask(site, job)[1]["outcome"] for job, _ in JOBS]
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(60)
    assert outcomes == [outcome for _, outcome in JOBS]
    recordings = sorted((tmp_path / "runs").glob("*/mission.mcap"))
    assert len(recordings) == len(JOBS)
    for path in recordings:
        again = replay(read_recording(path), recorded_estimates=True)
        assert again.difference is None and again.complete, f"{path.parent.name}: {again.difference} {again.ended}"
        assert again.states[-1] in ("CHARGING", "READY")
