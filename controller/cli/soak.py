"""``portdock soak``: missions back to back on mocks, with random faults, for hours or for a number of missions."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.cli.dry_run import FAST_FACTOR, for_mocks
from controller.config import SiteConfig, load_config
from controller.config_section import ConfigError
from controller.scenarios import check_name

if TYPE_CHECKING:
    from controller.soak.run import Line, Soak

GROWTH_MB = 10.0
FOREVER = 1_000_000

SoakPace = Annotated[
    float,
    typer.Option(min=1.0, max=4.0, help="Emulated seconds per wall second; above 3 with --config config/soak.yaml."),
]
LEAST_RELEASING_S = 10.0
"""Of wall time: a silent charger counts as lost after three seconds, and each of two requests may wait for that."""


def soak(
    hours: Annotated[float | None, typer.Option(min=0.0, help="No mission begins after so many hours.")] = None,
    missions: Annotated[int | None, typer.Option(min=1, help="So many missions.")] = None,
    faults: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of missions with a random fault.")] = 0.3,
    seed: Annotated[int, typer.Option(min=0, help="Cars, faults, noise.")] = 0,
    world: Annotated[
        int, typer.Option(min=1, help="Missions for each set of mocks; each has the car parked elsewhere.")
    ] = 10,
    pace: SoakPace = FAST_FACTOR,
    scenario: Annotated[str, typer.Option(help="nominal, or uncalibrated with the calibrations of --mock-cell.")] = (
        "nominal"
    ),
    mock_cell: Annotated[int | None, typer.Option(min=0, help="One cell's calibration errors in all worlds.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for soak.jsonl and the recordings.")] = Path("portdock-soak"),
    config: Annotated[Path | None, typer.Option(help="A site file; addresses are replaced by the mocks'.")] = None,
) -> None:
    """Run missions until the time is up or the number reached. Exit 1 for a leak or an unexplained outcome."""
    if hours is None and missions is None:
        raise ConfigError("neither --hours nor --missions", remedy="Say how long: `portdock soak --missions 20`.")
    from controller.soak.run import Plan, run_soak  # devices take seconds to import
    from drivers.base import MonotonicClock

    clock = MonotonicClock()
    end_s = float("inf") if hours is None else clock.now_s() + 3600.0 * hours
    check_name(scenario)
    plan = Plan(missions or FOREVER, end_s, seed, faults, world, pace, scenario, mock_cell)
    site = for_mocks(load_config(config), fast=pace > 1.0)
    check_site(site, pace)
    out.mkdir(parents=True, exist_ok=True)
    done = run_soak(site, plan, out.resolve(), clock, _tell)
    raise typer.Exit(0 if _judged(done) else 1)


def check_site(site: SiteConfig, pace: float) -> None:
    """Raises ConfigError where outcomes would not be what the soak takes them for."""
    if site.deadlines.releasing_s / pace < LEAST_RELEASING_S:
        raise ConfigError(
            f"at --pace {pace:g} RELEASING ends after {site.deadlines.releasing_s / pace:.1f} s of wall time, too early"
            " to tell that the charger is lost",
            remedy="Lower --pace, or give --config config/soak.yaml.",
        )
    if site.mission.on_final_failure != "retreat":
        raise ConfigError("a soak waits for nobody", remedy="Set mission.on_final_failure: retreat in its site file.")


def _tell(line: Line) -> None:
    trouble = f"{line.trouble} in {line.state}" if line.state else "no trouble"
    fault = f" ({line.fault}: {line.detail})" if line.fault else ""
    mark = "" if line.explained else "  NOT EXPLAINED"
    held = f"{line.rss_mb:.0f} MB, {line.descriptors} files, {line.threads} threads"
    print(f"{line.number + 1:5}  {line.duration_s:6.1f} s  {trouble}: {line.outcome}{fault}; {held}{mark}", flush=True)


def _judged(done: Soak) -> bool:
    """Print the sum; whether it is good."""
    grown = done.growth
    good = not done.unexplained and not done.given_up
    print(f"{len(done.lines)} missions, {len(done.unexplained)} not explained, {len(done.given_up)} cells given up")
    for text in done.given_up:
        print(f"given up: {text}")
    if grown is None:
        print("too few missions to tell whether anything grows")
        return good
    print(f"growth after warm-up: {json.dumps(asdict(grown))}")
    return good and grown.rss_mb < GROWTH_MB and grown.descriptors <= 0 and grown.threads <= 0
