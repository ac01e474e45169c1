"""The bench tests themselves, on mocks only: all stages green, and none that moves without being allowed to."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOT = Path(__file__).parents[2]
MOCKS = 'arm: {host: "mock:"}\nscanner: {device: "mock:"}\ncharger: {channel: "mock:"}\n'


def run_hil(*options: str) -> tuple[int, dict[str, int], str]:
    command = [sys.executable, "-m", "pytest", "tests/hil", "-q", "-p", "no:cacheprovider", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=850, cwd=ROOT, check=False)
    counts = {what: int(number) for number, what in re.findall(r"(\d+) (passed|failed|skipped|error)", done.stdout)}
    return done.returncode, counts, done.stdout


@pytest.mark.long  # four minutes and more of motion
def test_the_whole_suite_is_green_against_the_mocks(tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text(MOCKS)
    code, counts, said = run_hil("--hil", str(site), "--allow-motion", "--yes")
    assert code == 0 and counts.get("passed", 0) >= 15 and "skipped" not in counts, said


def test_without_flags_everything_is_skipped() -> None:
    code, counts, said = run_hil()
    assert code == 0 and set(counts) == {"skipped"}, said
