"""``portdock dry-run``: one docking mission with mock hardware."""

from __future__ import annotations

import json
import logging
import shutil
import sys
import tempfile
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from controller.calibrations.in_force import mock_names, on_mock_cell
from controller.cli.progress import make_display
from controller.config import SiteConfig, load_config
from controller.config_section import ConfigError
from controller.mock_calibrations import cell_name
from controller.port_files import load_port
from controller.scenarios import SCENARIOS, draw_scenario
from controller.summary import MissionSummary

log = logging.getLogger(__name__)

FAST_FACTOR = 2.0
"""Emulated seconds per wall second with --fast."""

Pace = Annotated[float, typer.Option(min=1.0, max=3.0, help="Emulated seconds per wall second of wires and arm.")]
"""Faster, a state's deadline (emulated time) runs out before a silent charger counts as lost (wall time)."""


def dry_run(
    seed: Annotated[int, typer.Option(min=0, help="Where the car stands, and all noise.")] = 0,
    scenario: Annotated[str, typer.Option(help="One of " + ", ".join(SCENARIOS) + ".")] = "nominal",
    fast: Annotated[bool, typer.Option("--fast", help=f"Wire and arm pacing {FAST_FACTOR:g} times as fast.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for recording and report; must not hold a recording.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="A site file; device addresses are replaced by the mocks'.")
    ] = None,
    can: Annotated[
        str | None, typer.Option(help="The mock charger's bus instead of a pty, as INTERFACE:CHANNEL: socketcan:vcan0.")
    ] = None,
    profile_rate_hz: Annotated[
        float | None,
        typer.Option(min=1.0, max=50.0, help="Of the mock scanner, where the host ray-casts no 50 a second."),
    ] = None,
    scanner: Annotated[
        str | None, typer.Option(help="A scanner with a site of its own: profiler2, scip_profiler.")
    ] = None,
    mock_cell: Annotated[
        int | None, typer.Option(min=0, help="Which mock cell, for its calibrations; the seed's own if left out.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of progress.")] = False,
) -> None:
    """Watch a whole docking cycle without hardware: three mocks on real wires, the very controller of the daemon."""
    from controller.mock_cell import MockCell  # devices and reports take seconds to import: other commands need none
    from controller.session import run_session

    site = for_mocks(load_config(config, scanner), fast)
    world = draw_scenario(scenario, site, load_port(site.port.model), seed, mock_cell)
    names = mock_names(cell_name(site, scenario, seed, mock_cell))
    folder = run_folder(out, site)
    pace = FAST_FACTOR if fast else 1.0
    with make_display(quiet=as_json) as display, tempfile.TemporaryDirectory(prefix="portdock-") as wires:
        if fast:
            display.note(f"fast: wires and arm run {pace:g} times as fast; heartbeats keep wall time; one device clock")
        with MockCell(Path(wires), site, world, seed, pace, can_bus(can), profile_rate(profile_rate_hz)) as cell:
            summary = run_session(
                on_mock_cell(cell.config, names),
                folder,
                display,
                pace=pace,
                heartbeat_mode=1,
                truth=None if world.plain_panel else world.T_base_port,
                notes=(("scenario", scenario), ("seed", str(seed)), ("pace", f"{pace:g}")),
            )
            keep_mock_logs(Path(wires), folder)
        display.finish(summary)
    finish(summary, as_json)


def profile_rate(rate_hz: float | None) -> tuple[str, ...]:
    """The mock scanner's option for it."""
    return () if rate_hz is None else ("--rate-hz", f"{rate_hz:g}")


def can_bus(text: str | None) -> tuple[str, str] | None:
    """``INTERFACE:CHANNEL`` as its two parts. Raises ConfigError."""
    if text is None:
        return None
    interface, _, channel = text.partition(":")
    if not interface or not channel or interface in ("slcan", "virtual"):
        raise ConfigError(
            f"--can {text} names no bus that two processes share",
            remedy="Give INTERFACE:CHANNEL of a bus that python-can opens, socketcan:vcan0 for instance.",
        )
    return interface, channel


def keep_mock_logs(wires: Path, folder: Path) -> None:
    """What the mocks complained about belongs to the evidence."""
    for log in wires.glob("mock-*.log"):
        if log.stat().st_size:
            shutil.copy(log, folder)


def run_folder(out: Path | None, site: SiteConfig) -> Path:
    """The folder for one mission's evidence; made if it is missing. Raises ConfigError."""
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")
    folder = out or Path(site.recording.folder) / stamp
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot make the folder {folder}: {error.strerror}", remedy="Give another --out.") from error
    return folder.resolve()


def for_mocks(site: SiteConfig, fast: bool = False) -> SiteConfig:
    """The same site with the host's limits widened, if they are not wider: a desk's scheduler is not the robot's.

    Fast, a millisecond of delay is several of arm motion: there the mocks stamp by one clock.
    """
    arm, charger = site.arm, site.charger
    changes: dict[str, dict[str, float | str]] = {
        "arm": {
            "freshness_ms": max(2000.0, arm.freshness_ms),
            "watchdog_hz": min(0.5, arm.watchdog_hz),
            "frequency_hz": 125,
        },
        "charger": {
            "degraded_ms": max(1000.0, charger.degraded_ms),
            "lost_ms": max(3000.0, charger.lost_ms),
            "ack_timeout_ms": max(2000.0, charger.ack_timeout_ms),
        },
        "scanner": {
            "silence_ms": max(5000.0, site.scanner.silence_ms),
            "sync": "shared_clock" if fast and site.scanner.sync == "timestamp" else site.scanner.sync,
        },
        "deadlines": {"locating_s": max(600.0, site.deadlines.locating_s)},  # perception takes wall time, fast or not
        "host": {"stall_ms": max(2000.0, site.host.stall_ms)},
    }
    sections = {name: getattr(site, name).model_copy(update=update) for name, update in changes.items()}
    if site.coarse is not None:
        first = site.coarse.scanner.model_copy(update=changes["scanner"])
        sections["coarse"] = site.coarse.model_copy(update={"scanner": first})
    return site.model_copy(update=sections)


def finish(summary: MissionSummary, as_json: bool) -> None:
    """Print the result where asked, and exit with the documented code."""
    if as_json:
        sys.stdout.write(json.dumps(summary.to_json()) + "\n")
    if summary.outcome != "charged":
        raise typer.Exit(4 if summary.fault == "gate-refused" else 1)
