"""``portdock scanner``: profiles of a device seen live."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from controller.cli.scanner import app
from drivers.base import LinkOpenError
from perception.errors import InputError
from tests.contract.scanner_bench import mock

RUN = CliRunner()


def test_profiles_are_shown_with_rate_extent_and_counters(tmp_path: Path) -> None:
    with mock(tmp_path / "dev"):
        shown = RUN.invoke(app, ["try", "wide_xz", "--device", str(tmp_path / "dev"), "--seconds", "1.2"])
    assert shown.exit_code == 0, shown.output
    last = shown.output.strip().splitlines()[-1]
    assert "points 974 (97% of the samples)" in last
    assert "x -77.9 to 77.9 mm" in last
    assert "bad_checksum 0" in last


def test_a_missing_device_and_a_missing_file_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(LinkOpenError, match="no serial device"):
        RUN.invoke(app, ["try", "wide_xz", "--device", str(tmp_path / "dev")], catch_exceptions=False)
    with pytest.raises(InputError, match="no scanner description"):
        RUN.invoke(app, ["try", "mine.yaml", "--device", str(tmp_path / "dev")], catch_exceptions=False)


def test_bundled_descriptions_are_listed() -> None:
    assert "ld19" in RUN.invoke(app, ["list"]).output
