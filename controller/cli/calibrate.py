"""``portdock calibrate``: what is constant about a site and can be measured, and the files that it is kept in."""

from __future__ import annotations

import json
from contextlib import ExitStack
from typing import Annotated

import typer

from controller.cli import calibrate_drift, calibrate_hand_eye, calibrate_tcp, calibration_files
from controller.cli.scan import ConfigOption, MockOption, ScannerOption, SeedOption, cell_for, show_quarters
from controller.config import load_config

app = typer.Typer(help="Measure what is constant about a site.", no_args_is_help=True)
app.command("hand-eye")(calibrate_hand_eye.hand_eye)
app.command()(calibrate_tcp.tcp)
app.command()(calibrate_drift.drift)
app.command()(calibration_files.show)
app.command()(calibration_files.budget)
app.command()(calibration_files.compare)
app.command()(calibration_files.restore)


@app.command("time-offset")
def time_offset(
    config: ConfigOption = None,
    scanner: ScannerOption = None,
    mock: MockOption = False,
    seed: SeedOption = 0,
    mock_latency_ms: Annotated[float, typer.Option(help="With --mock: the delay to be found.")] = 0.0,
    rounds: Annotated[int, typer.Option(min=1, max=20, help="So many times forth and back.")] = 2,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Sweep the port forth and back and print ``scanner.latency_ms`` for the site file. The arm will move."""
    from controller.calibrations.time_offset_session import measure_time_offset  # devices take seconds to import

    with ExitStack() as closing:
        wanted = load_config(config, scanner)
        site, pace = cell_for(
            closing, wanted, mock, seed, "nominal", False, ("--latency-s", str(mock_latency_ms / 1e3))
        )
        mode = 1 if mock else 3
        found = measure_time_offset(site, rounds, show_quarters, pace=pace, heartbeat_mode=mode)
    if as_json:
        typer.echo(json.dumps(found.to_json()))
        return
    typer.echo(
        f"scanner.latency_ms: {found.latency_ms:.2f}  # was {site.scanner.latency_ms:g};"
        f" 1 sigma {found.sigma_ms:.2f} ms over {len(found.offsets_ms)} rounds"
    )
