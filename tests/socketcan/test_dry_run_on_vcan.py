"""One whole dry run with the charger on the kernel's own CAN: three mock processes, the very controller, a report.

This kernel has one processor, and each of its system calls costs several of the host's: what the arm and the scanner
may take is stretched as far as the configuration allows, and the mock scanner makes fewer profiles in a slower sweep.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from controller.recording.reader import read_recording

TIMEOUT_S = 480
SITE = """
site: user-mode-linux
scan: {speed_mm_s: 5.0}
arm: {freshness_ms: 5000.0, watchdog_hz: 0.2}
charger: {degraded_ms: 4000.0, lost_ms: 5000.0, ack_timeout_ms: 10000.0}
scanner: {silence_ms: 30000.0, sync: shared_clock}
host: {stall_ms: 10000.0}
deadlines: {self_check_s: 300.0, staging_s: 300.0, scanning_s: 300.0, locating_s: 600.0, approaching_s: 300.0,
  inserting_s: 300.0, verifying_s: 200.0, releasing_s: 300.0, retreating_s: 300.0}
mission: {charge_s: 2.0}
"""
CYCLE = [
    "SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING", "CHARGING",
    "RELEASING", "RETREATING", "READY",
]  # fmt: skip
ROBOT, CHARGER = 0xB0, 0x56


@pytest.mark.timeout(TIMEOUT_S + 30)
def test_a_whole_docking_cycle_on_vcan(tmp_path: Path) -> None:
    site, out = tmp_path / "site.yaml", tmp_path / "out"
    site.write_text(SITE)
    command = [sys.executable, "-m", "controller.cli.main", "dry-run", "--json", "--can", "socketcan:vcan0"]
    command += ["--profile-rate-hz", "5", "--config", str(site), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=TIMEOUT_S)
    assert done.stdout, done.stderr
    result = json.loads(done.stdout)
    assert (result["outcome"], result["fault"]) == ("charged", None), done.stdout + done.stderr
    states = [name for name, _ in result["states"]]
    assert states[:3] == CYCLE[:3]
    assert states[-6:] == CYCLE[-6:]
    recording = read_recording(Path(result["recording"]))
    assert recording.complete
    frames = recording.can_frames()
    assert {frame.arbitration_id & 0xFF for frame in frames} == {ROBOT, CHARGER}
    assert b"interface: socketcan" in recording.attachments["config.yaml"].data
