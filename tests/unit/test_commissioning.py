"""docs/commissioning.md names only what exists: commands, options, files of the installation, bench tests."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer
import yaml

from controller.cli.main import app
from controller.config import load_config

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "commissioning.md").read_text()
LINES = re.findall(r"^    \$ (.+)$", TEXT, re.MULTILINE)
PORTDOCK = [line for line in LINES if line.startswith("portdock ")]


def resolved(words: list[str]) -> tuple[object, list[str]]:
    """The command that the words name, and the words that are left for it."""
    command: object = typer.main.get_command(app)
    while words and hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    return command, words


@pytest.mark.parametrize("line", [*PORTDOCK, *sorted(set(re.findall(r"`(portdock [a-z-]+)`", TEXT)))])
def test_every_portdock_command_and_option_exists(line: str) -> None:
    command, rest = resolved(shlex.split(line)[1:])
    known = {name for parameter in command.params for name in parameter.opts} | {"--help"}  # type: ignore[attr-defined]
    assert {word for word in rest if word.startswith("--")} <= known


def test_every_bench_test_and_installed_file_exists() -> None:
    for path in re.findall(r"tests/hil/\S+\.py", TEXT):
        assert (ROOT / path).is_file(), path
    for name in re.findall(r"/opt/portdock/lib/\S+/(\S+)", TEXT):
        assert (ROOT / "docs" / "deploy" / name).is_file(), name


def test_the_site_file_shown_is_valid(tmp_path: Path) -> None:
    shown = re.search(r"^    site: .+?\n\n", TEXT, re.MULTILINE | re.DOTALL)
    assert shown is not None
    text = re.sub(r"^    ", "", shown.group(), flags=re.MULTILINE)
    assert yaml.safe_load(text)["site"] == "bay-1"
    (tmp_path / "site.yaml").write_text(text)
    assert load_config(tmp_path / "site.yaml").arm.host == "192.168.0.10"
