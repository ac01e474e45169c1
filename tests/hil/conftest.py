"""Bench tests: ``pytest tests/hil --hil site.yaml [--allow-motion] [--yes]``. Skipped without ``--hil``.

The stages run in the order of their files, each more daring than the one before; after a stage that failed, what is
more daring is not tried. ``--yes`` answers for the operator only where the arm is ``mock:``; a real arm always waits.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from controller.assembly import Assembly
from tests.hil.bench import Bench, load_bench

MOTION_FROM = 4
"""Stages from this one on move the arm."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("hil", "bench tests on the devices of a site")
    group.addoption("--hil", metavar="SITE", help="site file; an address of mock: is the device's mock")
    group.addoption("--allow-motion", action="store_true", help="also the stages that move the arm")
    group.addoption("--yes", action="store_true", help="do not wait for the operator; counts only for a mock arm")


def stage_of(item: pytest.Item) -> int:
    """The number in the file's name: test_4_small_moves.py is 4."""
    return int(item.path.name.split("_")[1]) if item.path.parent == Path(__file__).parent else 0


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    site = config.getoption("--hil", None)
    allowed = config.getoption("--allow-motion", False)
    for item in items:
        stage = stage_of(item)
        if stage == 0:
            continue
        item.add_marker(pytest.mark.timeout(900))
        if site is None:
            item.add_marker(pytest.mark.skip(reason="bench test: give --hil SITE"))
        elif stage >= MOTION_FROM and not allowed:
            item.add_marker(pytest.mark.skip(reason="moves the arm: give --allow-motion"))


_failed_stage: list[int] = []


def pytest_runtest_setup(item: pytest.Item) -> None:
    if any(failed < stage_of(item) for failed in _failed_stage):
        pytest.skip("an earlier stage failed: nothing more daring is tried")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed and "/hil/" in f"/{report.nodeid}":
        _failed_stage.append(int(Path(report.nodeid.split("::")[0]).name.split("_")[1]))


@pytest.fixture(scope="session")
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    with ExitStack() as closing:
        yield load_bench(Path(request.config.getoption("--hil")), closing)


@pytest.fixture(scope="module")
def live(bench: Bench) -> Iterator[Assembly]:
    """All three links open; closed with the stage."""
    with ExitStack() as closing:
        yield bench.assemble(closing)


Announce = Callable[[str], None]


@pytest.fixture
def announce(request: pytest.FixtureRequest, bench: Bench) -> Announce:
    """Say what will happen and wait for the operator, where that is not a mock's arm and ``--yes``."""

    def say(what: str) -> None:
        capture = request.config.pluginmanager.getplugin("capturemanager")
        with capture.global_and_fixture_disabled():
            sys.stdout.write(f"\n  {what}\n")
            if "arm" in bench.mocked and request.config.getoption("--yes"):
                return
            if not _confirmed():
                pytest.skip("the operator did not confirm")

    return say


def _confirmed() -> bool:
    """The operator at the terminal types yes; without a terminal there is no operator."""
    try:
        with open("/dev/tty", "r+", encoding="utf-8", buffering=1) as terminal:
            terminal.write("  Hand on the emergency stop, nobody in reach? Type yes to go on: ")
            return terminal.readline().strip().lower() == "yes"
    except OSError:
        return False
