"""The figures on the loopback interface: what Prometheus and a monitor read."""

from __future__ import annotations

import json
import re
import socket
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from controller.cli.jobs import _rows
from controller.faults import Fault, FaultCode, Outcome
from controller.states import State
from controller.status.board import Status, StatusBoard
from controller.status.web import StatusWeb, as_prometheus
from drivers.base import LinkHealth
from tests.unit.mission_rig import CLOCK, Rig

SAMPLE = re.compile(r'^[a-z_]+(\{[a-z_]+="[^"\n]*"(,[a-z_]+="[^"\n]*")*\})? [-+0-9.einf]+$')


@pytest.fixture
def board(tmp_path: Path) -> StatusBoard:
    board = StatusBoard(CLOCK)
    board.attach(Rig(tmp_path).cell)
    board.entered(State.READY)
    return board


def get(port: int, path: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10) as reply:
            return reply.status, reply.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_metrics_are_prometheus_text_and_name_the_state(board: StatusBoard) -> None:
    text = as_prometheus(board.status())
    lines = [line for line in text.splitlines() if not line.startswith("# ")]
    assert all(SAMPLE.match(line) for line in lines), [line for line in lines if not SAMPLE.match(line)]
    assert 'portdock_state{state="READY"} 1' in lines and 'portdock_state{state="FAULT"} 0' in lines
    assert {f'portdock_link_up{{link="{name}"}} 1' for name in ("arm", "scanner", "charger")} <= set(lines)
    families = re.findall(r"^# TYPE (\S+)", text, re.MULTILINE)
    assert len(families) == len(set(families))


def test_what_the_lines_lost_is_in_status_figures_and_on_the_terminal_also_of_a_coarse_scanner(tmp_path: Path) -> None:
    cell = Rig(tmp_path).cell
    counted = LinkHealth(
        True, CLOCK.now_s(), (("bytes", 9000), ("bytes_dropped", 47), ("bad_checksum", 1), ("late", 0))
    )
    coarse = SimpleNamespace(health=lambda: counted)
    board = StatusBoard(CLOCK)
    board.attach(replace(cell, coarse=coarse))  # type: ignore[arg-type]
    status = board.status()
    assert 'portdock_link_events_total{link="coarse",what="bytes_dropped"} 47' in as_prometheus(status)
    assert status.to_json()["links"]["coarse"]["counters"] == dict(counted.counters)
    assert dict(_rows(status.to_json()))["coarse"] == "up bytes_dropped 47, bad_checksum 1"


def test_outcomes_and_faults_are_counted(board: StatusBoard) -> None:
    for kind in ("charging", "charging", "undocked"):
        board.ended(Outcome(kind), 1)  # type: ignore[arg-type]
    board.entered(State.FAULT)
    board.ended(Outcome.of(Fault(FaultCode.ARM_LINK_LOST, 'the "arm" is\nsilent')), 1)
    text = as_prometheus(board.status())
    assert 'portdock_missions_total{outcome="charging"} 2' in text
    assert 'portdock_faults_total{fault="arm-link-lost"} 1' in text and "portdock_fault_latched 1" in text


def test_health_is_200_while_nobody_is_needed_and_503_with_the_remedy_else(board: StatusBoard) -> None:
    port = free_port()
    web = StatusWeb(port, board.status)
    try:
        code, text = get(port, "/health")
        assert code == 200 and json.loads(text)["state"] == "READY"
        board.entered(State.FAULT)
        board.ended(Outcome.of(Fault(FaultCode.EMERGENCY_STOP, "pressed at the robot")), 1)
        code, text = get(port, "/health")
        assert code == 503 and "release the emergency stop" in json.loads(text)["remedy"]
        assert get(port, "/metrics")[0] == 200 and get(port, "/reset")[0] == 404
    finally:
        web.close()


def test_a_taken_port_costs_the_figures_and_not_the_daemon(board: StatusBoard) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        StatusWeb(taken.getsockname()[1], board.status).close()


def test_a_status_without_devices_is_not_healthy() -> None:
    status: Status = StatusBoard(CLOCK).status()
    assert not status.healthy and status.robot_mode is None and as_prometheus(status)
