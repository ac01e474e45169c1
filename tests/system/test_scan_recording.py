"""``portdock scan``, ``convert`` and the replay of what was recorded: as a user types them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controller.cli.main import app
from controller.recording.reader import read_recording
from drivers.base import LinkOpenError
from perception.cloud_io import read_cloud
from perception.errors import InputError


def portdock(*arguments: str, folder: Path) -> str:
    """The command's standard output. Fails with its errors unless it exits 0."""
    command = [sys.executable, "-m", "controller.cli.main", *arguments]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_sweep_is_recorded_and_converted_to_every_format(tmp_path: Path) -> None:
    shown = portdock("scan", "--mock", "--fast", "--out", "sweep.mcap", folder=tmp_path)
    assert "bad_checksum 0" in shown
    recording = read_recording(tmp_path / "sweep.mcap")
    assert recording.complete
    assert b"".join(chunk.data for chunk in recording.scanner_chunks("tx")).startswith(b"L1\r\n")
    assert len(recording.scanner_chunks("rx")) > 20
    assert len(recording.arm_table()) > 100
    assert {"scanner_offset_s", "scanner_drift_ppm", "arm_offset_s"} <= set(recording.metadata["clocks"])
    assert {"scanner", "arm"} <= {report.link for report in recording.links()}
    points = recording.scans()[0].cloud.points
    for source, target in (("sweep.mcap", "a.ply"), ("a.ply", "b.pcd"), ("sweep.mcap", "c.npz")):
        ran = CliRunner().invoke(app, ["convert", str(tmp_path / source), str(tmp_path / target)])
        assert ran.exit_code == 0, ran.output
        np.testing.assert_allclose(read_cloud(tmp_path / target).points, points, atol=1e-6)


def test_what_cannot_be_converted_is_said_in_one_line(tmp_path: Path) -> None:
    from controller.cli.convert import convert

    (tmp_path / "a.ply").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="cannot be read"):
        convert(tmp_path / "a.ply", tmp_path / "b.pcd", None, "m")
    with pytest.raises(InputError, match=r"cannot write \.stl"):
        convert(tmp_path / "a.ply", tmp_path / "b.stl", None, "m")


def test_a_missing_scanner_leaves_no_recording(tmp_path: Path) -> None:
    from controller.config import load_config
    from controller.scan_session import record_scan

    site = load_config()
    charger = site.charger.model_copy(update={"channel": str(tmp_path / "none")})
    with pytest.raises(LinkOpenError):
        record_scan(site.model_copy(update={"charger": charger}), tmp_path / "sweep.mcap", lambda *_: None)
    assert not (tmp_path / "sweep.mcap").exists()
