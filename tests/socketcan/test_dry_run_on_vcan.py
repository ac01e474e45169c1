"""One whole dry run with the charger on the kernel's own CAN: three mock processes, the very controller, a report.

This kernel has one processor, and each of its system calls costs several of the host's: see ``dry_run_on_vcan`` for the
patience and the slow motion that takes. Four minutes on a quiet machine; on a busy one it may end as a lost link.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from controller.recording.reader import read_recording

TIMEOUT_S = 780
CYCLE = [
    "SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING", "CHARGING",
    "RELEASING", "RETREATING", "READY",
]  # fmt: skip
ROBOT, CHARGER = 0xB0, 0x56


@pytest.mark.timeout(TIMEOUT_S + 30)
def test_a_whole_docking_cycle_on_vcan(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.socketcan.dry_run_on_vcan", "socketcan:vcan0", str(tmp_path / "out")]
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
