"""What the scanner's contract tests share: a mock's process on a symlinked pty, and patience with conditions."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.base import Scanner
from perception.scan import Profile

PATIENCE_S = 20.0


@contextmanager
def mock(link: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A mock scanner that listens on ``link``."""
    command = [sys.executable, "-m", "mocks.scanner", "--link", str(link), *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        assert select.select([process.stdout], [], [], PATIENCE_S)[0], "the mock does not come up"
        assert json.loads(process.stdout.readline())["device"] == str(link)
        yield process
    finally:
        process.terminate()
        process.wait(PATIENCE_S)
        assert process.stdout is not None
        process.stdout.close()


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition, at most PATIENCE_S."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, f"not within {PATIENCE_S} s: {what}"
        time.sleep(0.005)


def take(scanner: Scanner, count: int) -> list[Profile]:
    """At least ``count`` profiles."""
    profiles: list[Profile] = []

    def enough() -> bool:
        profiles.extend(scanner.take())
        return len(profiles) >= count

    until(enough, f"{count} profiles")
    return profiles
