"""``portdock config``: check a site file, show the effective values."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from controller.config import as_yaml, load_config
from controller.port_files import load_port
from controller.scanner_files import load_scanner

app = typer.Typer(help="Check and show the configuration.", no_args_is_help=True)


@app.command()
def check(file: Annotated[Path, typer.Argument(help="A site file (YAML).")]) -> None:
    """Check a site file: every key known, every value within its bounds, port and scanner descriptions readable."""
    config = load_config(file)
    load_port(config.port.model)
    load_scanner(config.scanner.format)
    print(f"{file}: ok (site {config.site}, port {config.port.model}, arm {config.arm.model})")


@app.command()
def show(file: Annotated[Path | None, typer.Argument(help="A site file; without one the defaults.")] = None) -> None:
    """Print every key with its effective value."""
    print(as_yaml(load_config(file)), end="")
