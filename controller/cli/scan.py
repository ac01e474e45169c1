"""``portdock scan``: one sweep from any scanner into a recording."""

from __future__ import annotations

import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from controller.calibrations.in_force import calibrated, mock_names, on_mock_cell
from controller.calibrations.record import Kind
from controller.cli.dry_run import FAST_FACTOR, for_mocks
from controller.config import SiteConfig, load_config
from controller.mock_calibrations import cell_name
from controller.port_files import load_port
from controller.scenarios import SCENARIOS, draw_scenario

ConfigOption = Annotated[Path | None, typer.Option(help="The site file.")]
ScannerOption = Annotated[str | None, typer.Option(help="A scanner with a bundled site: profiler2, scip_profiler.")]
MockOption = Annotated[bool, typer.Option("--mock", help="Mock devices instead of the site's.")]
SeedOption = Annotated[int, typer.Option(min=0, help="With --mock: where the car stands, and all noise.")]
ErrorsOption = Annotated[str, typer.Option("--scenario", help="With --mock: whose calibration errors.")]
WorldOption = Annotated[str, typer.Option(help="With --mock: one of " + ", ".join(SCENARIOS) + ".")]
MockCellOption = Annotated[int | None, typer.Option(min=0, help="With --mock: which cell; the seed's own.")]
FastOption = Annotated[bool, typer.Option("--fast", help=f"With --mock: {FAST_FACTOR:g} times as fast.")]


def scan(
    out: Annotated[Path, typer.Option(help="The recording to write (.mcap); never overwritten.")],
    config: ConfigOption = None,
    scanner: ScannerOption = None,
    mock: MockOption = False,
    seed: SeedOption = 0,
    scenario: WorldOption = "nominal",
    fast: FastOption = False,
) -> None:
    """Sweep once over the port and record it: raw bytes, arm poses, clocks, cloud. The arm will move."""
    from controller.scan_session import record_scan  # devices take seconds to import

    with ExitStack() as closing:
        site, pace = cell_for(closing, load_config(config, scanner), mock, seed, scenario, fast)
        mode = 1 if mock else 3
        done = record_scan(site, out.resolve(), show_quarters, pace=pace, heartbeat_mode=mode)
    counters = "  ".join(f"{name} {count}" for name, count in done.scanner.counters)
    typer.echo(f"{out}: {done.profiles} profiles, {len(done.cloud)} points\n  {counters}")


def cell_for(
    closing: ExitStack,
    site: SiteConfig,
    mock: bool,
    seed: int,
    scenario: str,
    fast: bool,
    scanner_options: tuple[str, ...] = (),
    number: int | None = None,
    remade: tuple[Kind, ...] = (),
) -> tuple[SiteConfig, float]:
    """The site to open with its calibrations, and its pace; or mock devices that live until ``closing`` ends.

    ``number``: which mock cell, if not the seed's own. ``remade``: calibrations that need not be in order, since they
    are about to be made anew.
    """
    if not mock:
        return calibrated(site, remade), 1.0
    from controller.mock_cell import MockCell  # the world takes a second to import

    pace = FAST_FACTOR if fast else 1.0
    site = for_mocks(site, fast)
    world = draw_scenario(scenario, site, load_port(site.port.model), seed, number)
    wires = closing.enter_context(tempfile.TemporaryDirectory(prefix="portdock-"))
    cell = MockCell(Path(wires), site, world, seed, pace, scanner_options=scanner_options)
    devices = mock_names(cell_name(site, scenario, seed, number))
    return on_mock_cell(closing.enter_context(cell).config, devices), pace


def show_quarters(label: str, fraction: float, detail: str) -> None:
    """Progress on a terminal, nothing elsewhere."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{label} {fraction:4.0%}  {detail} ")
