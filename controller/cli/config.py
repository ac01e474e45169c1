"""``portdock config``: check a site file; effective values and where they come from; the schema for editors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from controller.config import load_config, parse_config
from controller.config_keys import json_schema, listing
from controller.config_layers import layers, merged
from controller.config_section import ConfigError
from controller.port_files import load_port
from controller.precision import refuse_too_coarse
from controller.scanner_files import load_scanner
from controller.wiring import check_charger

app = typer.Typer(help="Check and show the configuration.", no_args_is_help=True)


@app.command()
def check(file: Annotated[Path, typer.Argument(help="A site file (YAML).")]) -> None:
    """Check a site file: every key known, every value within its bounds, port, scanner and CAN contract usable."""
    config = load_config(file)
    load_port(config.port.model)
    load_scanner(config.scanner.format)
    refuse_too_coarse(config)
    check_charger(config)
    print(f"{file}: ok (site {config.site}, port {config.port.model}, arm {config.arm.model})")


@app.command()
def show(
    file: Annotated[Path | None, typer.Argument(help="A site file; without one the defaults.")] = None,
    docs: Annotated[
        bool, typer.Option("--docs", help="Above each key its unit, its bounds and what it means.")
    ] = False,
) -> None:
    """Print every key with its effective value and its origin, as YAML that is a valid site file."""
    found = layers(file)
    print(listing(parse_config(merged(found)), found, docs), end="")


@app.command()
def schema(out: Annotated[Path | None, typer.Option("--out", help="Write it here instead.")] = None) -> None:
    """The JSON Schema of a site file. In a YAML file: ``# yaml-language-server: $schema=portdock.schema.json``."""
    if out is None:
        print(json_schema())
        return
    try:
        out.write_text(json_schema() + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"cannot write {out}: {error.strerror}", remedy="Give a path in a writable folder."
        ) from error
    print(out)
