"""docs/calibration.md names only commands, options and keys that exist, and shows the budget as it is printed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer

from controller.calibrations.budget import budget_table
from controller.cli.main import app
from controller.config import load_config
from controller.config_keys import keys

TEXT = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text()
LINES = re.findall(r"^    \$ portdock (.+)$", TEXT, re.MULTILINE)


@pytest.mark.parametrize("line", LINES)
def test_every_command_and_option_exists(line: str) -> None:
    words, command = shlex.split(line), typer.main.get_command(app)
    while words and hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    known = {name for parameter in command.params for name in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known


def test_every_key_exists() -> None:
    named = set(re.findall(r"`((?:calibration|scanner|arm|port)\.[A-Za-z_]+)`", TEXT))
    assert named
    assert named <= {key.name for key in keys()}


def test_the_budget_is_what_the_command_prints() -> None:
    assert "\n".join(budget_table({}, load_config().scan.standoff_mm)) in TEXT
