"""docs/operation.md tells the truth: commands, options, faults with their remedies, settings and figures by name."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from controller.config import load_config
from controller.faults import NEEDS_A_PERSON, REMEDIES, FaultCode
from tests.unit.test_commissioning import resolved

TEXT = (Path(__file__).parents[2] / "docs" / "operation.md").read_text()
COMMANDS = re.findall(r"^ +\$ (portdock [^#\n]+)", TEXT, re.MULTILINE)


def test_the_page_shows_commands() -> None:
    assert len(COMMANDS) > 10


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_and_option_exists(line: str) -> None:
    command, rest = resolved(shlex.split(line)[1:])
    known = {name for parameter in command.params for name in parameter.opts}  # type: ignore[attr-defined]
    assert {word for word in rest if word.startswith("--")} <= known


@pytest.mark.parametrize("code", list(FaultCode), ids=lambda code: code.value)
def test_every_fault_stands_there_with_its_remedy(code: FaultCode) -> None:
    person = "yes" if code in NEEDS_A_PERSON else ""
    assert f"| `{code.value}` | {person} | {REMEDIES[code]} |" in TEXT


def test_every_figure_is_served() -> None:
    source = (Path(__file__).parents[2] / "controller" / "status" / "web.py").read_text()
    for name in re.findall(r"`(portdock_[a-z_]+)", TEXT):
        assert f'"{name}"' in source, name


def test_every_setting_exists() -> None:
    site = load_config(None)
    for section, key in re.findall(r"`(recording|mission|service)\.(?!mcap)([a-z_]+)`", TEXT):
        assert hasattr(getattr(site, section), key), f"{section}.{key}"
