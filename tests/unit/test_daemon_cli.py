"""The commands that talk to the daemon: what they print, and the exit codes that scripts rely on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from controller.cli.main import app, exit_code
from controller.daemon.protocol import Request
from drivers.base import LinkOpenError
from tests.unit.daemon_rig import Nursery, Service


@pytest.fixture(scope="module")
def nursery() -> Iterator[Nursery]:
    nursery = Nursery()
    yield nursery
    nursery.close()


@pytest.fixture
def daemon(nursery: Nursery, tmp_path: Path) -> Iterator[Service]:
    running = Service(nursery, tmp_path)
    running.status()
    yield running
    running.close()


def run(daemon: Service, *words: str) -> tuple[int, dict[str, Any]]:
    result = CliRunner().invoke(app, [*words, "--json", "--socket", str(daemon.socket)])
    return result.exit_code, json.loads(result.stdout.splitlines()[-1])


def test_a_day_of_an_operator(daemon: Service) -> None:
    code, status = run(daemon, "status")
    assert (code, status["state"], status["healthy"]) == (0, "READY", True)
    code, docked = run(daemon, "dock")
    assert (code, docked["outcome"], docked["fault"]) == (0, "charging", None)
    assert Path(docked["recording"]).exists()
    assert run(daemon, "dock")[1]["outcome"] == "already-docked"
    code, stopped = run(daemon, "stop")
    assert (code, stopped["outcome"]) == (0, "stopped")
    code, nothing = run(daemon, "stop")
    assert (code, nothing["outcome"]) == (0, "nothing-to-do")


def test_a_fault_is_exit_1_with_its_remedy_until_the_reset(daemon: Service) -> None:
    code, aborted = run(daemon, "abort")
    assert (code, aborted["fault"]) == (0, "aborted"), "the abort did what was asked"
    code, status = run(daemon, "status")
    assert code == 1 and status["remedy"]
    code, refused = run(daemon, "dock")
    assert (code, refused["fault"]) == (1, "aborted") and "Reset" in refused["remedy"]
    assert run(daemon, "reset")[0] == 0 and run(daemon, "status")[0] == 0


def test_a_job_beside_another_is_exit_5(daemon: Service) -> None:
    with daemon.client() as client:
        client.ask(Request.DOCK)
        code, refused = run(daemon, "undock")
    assert (code, refused["outcome"]) == (5, "refused") and "under way" in refused["remedy"]


def test_for_people_there_are_lines(daemon: Service) -> None:
    result = CliRunner().invoke(app, ["dock", "--socket", str(daemon.socket)])
    assert result.exit_code == 0
    assert [word for word in ("STAGING", "INSERTING", "CHARGING", "recording:") if word not in result.stdout] == []
    status = CliRunner().invoke(app, ["status", "--socket", str(daemon.socket)])
    assert status.exit_code == 0 and "LATCHED, lock LOCKED, 32.0 A" in status.stdout


def test_without_a_daemon_the_exit_code_is_3_and_says_how_to_start_one(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["status", "--socket", str(tmp_path / "none")])
    assert isinstance(result.exception, LinkOpenError) and exit_code(result.exception) == 3
    assert "portdock run --mock" in result.exception.remedy
