"""Stage 6, docking: the whole procedure at the configured speed, into the port, charge, and out again."""

from __future__ import annotations

from pathlib import Path

import pytest

from controller.recording.reader import read_recording
from controller.session import run_session
from tests.hil.bench import Bench
from tests.hil.conftest import Announce


class Quiet:
    def state(self, name: str, elapsed_s: float) -> None: ...
    def progress(self, label: str, fraction: float, detail: str) -> None: ...


def test_a_docking(bench: Bench, announce: Announce, tmp_path: Path) -> None:
    if bench.mixed:
        pytest.skip("real and mock devices share no plug")
    announce("The arm will scan the port, DOCK at the configured speed, THE CHARGER WILL SWITCH POWER ON, then undock.")
    summary = run_session(bench.config, tmp_path / "docking", Quiet(), pace=bench.pace)
    assert (summary.outcome, summary.fault) == ("charged", None), summary.remedy
    assert summary.contact is not None and summary.contact.peak_force_n < bench.config.insertion.max_axial_force_n * 1.1
    assert summary.recording is not None and read_recording(summary.recording).complete
