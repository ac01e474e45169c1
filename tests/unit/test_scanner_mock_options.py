"""What is wrong on the mock scanner's command line is said in two lines, with exit code 2."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mocks.scanner.options import read_options, reading
from mocks.scanner.recorded_line import read_conversation
from mocks.scanner.sources import RecordedSource
from perception.errors import InputError


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        ("--protocol modbus", "invalid choice"),
        ("--baud -1", "-1 is not above 0"),
        ("--lost 3", "3 is no probability"),
        ("--time-scale 0", "0 is not above 0"),
        ("--jitter-s -1", "-1 is below 0"),
        ("--frobnicate", "unrecognized"),
        ("--source world", "needs --world"),
        ("--preset ld19 --protocol scip", "--preset belongs to"),
        ("--preset ld19 --source a.npz", "no recorded sweep"),
        ("--protocol scip --source a.npz", "no recorded sweep"),
        ("--coarse", "--coarse needs"),
        ("--trigger-output 3", "--trigger-output needs"),
    ],
)
def test_options_that_are_wrong_or_do_not_go_together_are_refused(arguments: str, cause: str) -> None:
    with pytest.raises(InputError, match=cause) as caught:
        read_options(arguments.split())
    assert "portdock mock scanner --help" in caught.value.remedy


def test_files_that_are_missing_or_something_else_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "garbage").write_text("garbage")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for read in (read_conversation, RecordedSource):
        for name, cause in (("none", "No such file"), ("garbage", "is not a file of that kind")):
            with pytest.raises(InputError, match=cause), reading(tmp_path / name, "a file of that kind"):
                read(tmp_path / name)
    with pytest.raises(InputError, match=r"other\.npz is not a sweep"), reading(tmp_path / "other.npz", "a sweep"):
        RecordedSource(tmp_path / "other.npz")


def test_the_process_ends_with_two_lines_and_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mocks.scanner", "--recording", str(tmp_path / "none.mcap")]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    cause, remedy = ran.stderr.splitlines()
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "none.mcap: No such file" in cause
    assert remedy.startswith("  remedy: Give the path of a recording")
