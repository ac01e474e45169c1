"""A few cells of the fault campaign as a user runs them: command line, real wires, the table at the end."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.timeout(600)
def test_an_emergency_stop_and_an_abort_on_the_way_to_staging_keep_their_rules(tmp_path: Path) -> None:
    out = tmp_path / "campaign"
    command = [sys.executable, "-m", "controller.cli.main", "campaign", "--out", str(out)]
    command += ["--faults", "emergency-stop,abort", "--states", "STAGING"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=580, check=False)
    table = (out / "campaign.md").read_text()
    assert ran.returncode == 0, ran.stdout + ran.stderr + table
    assert "2 ok, 0 BROKEN, 0 impossible, 0 not run" in table
    assert (out / "campaign.html").exists()
    again = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert again.returncode == 0
    assert "STAGING" not in again.stdout, "a campaign that is complete runs nothing again"
