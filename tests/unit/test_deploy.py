"""The files of an installation: that systemd takes the unit, and that unit, rules and defaults fit one another."""

from __future__ import annotations

import configparser
import shutil
import subprocess
from pathlib import Path

import pytest

from controller.config import load_config
from controller.daemon.places import SYSTEM_SOCKET

DEPLOY = Path(__file__).parents[2] / "docs" / "deploy"


def ini(name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(DEPLOY / name)
    return parser


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    program = tmp_path / "portdock"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    unit = tmp_path / "portdock.service"
    text = (DEPLOY / "portdock.service").read_text()
    unit.write_text(text.replace("/opt/portdock/bin/portdock", str(program)))
    said = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False)
    about_it = [line for line in said.stderr.splitlines() if "portdock.service" in line]
    assert said.returncode == 0 and about_it == [], said.stderr


def test_the_unit_waits_longer_than_a_mission_takes_to_finish_safely() -> None:
    service, deadlines = ini("portdock.service")["Service"], load_config().deadlines
    finishing_s = deadlines.inserting_s + deadlines.releasing_s + deadlines.retreating_s
    assert float(service["TimeoutStopSec"]) > finishing_s
    assert (service["Type"], service["Restart"]) == ("notify", "on-failure")
    assert 1.0 <= float(service["WatchdogSec"]) <= 30.0


def test_the_unit_gives_the_socket_the_place_where_clients_look() -> None:
    assert Path("/run") / ini("portdock.service")["Service"]["RuntimeDirectory"] == SYSTEM_SOCKET.parent


def test_the_network_file_sets_the_bit_rate_of_the_default_site() -> None:
    assert ini("80-portdock-can.network")["CAN"]["BitRate"] == "250K"
    assert load_config().charger.bitrate_bps == 250_000


def test_every_rule_is_complete() -> None:
    rules = [line for line in (DEPLOY / "60-portdock.rules").read_text().splitlines() if line and line[0] != "#"]
    assert len(rules) == 3
    for rule in rules:
        for part in rule.split(", "):
            assert part.count('"') == 2 and "=" in part, part
