"""``portdock scanner``: look at what a laser scanner sends, through the very driver that a mission uses."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from controller.config import SiteConfig
from controller.scanner_files import ScannerDescription, bundled_scanners, load_scanner
from controller.wiring import build_devices
from drivers.base import LinkHealth, MonotonicClock, NullSink, Scanner
from perception.scan import Profile

app = typer.Typer(help="Laser scanners: bundled descriptions, and profiles live.", no_args_is_help=True)
_REFRESH_S = 0.5


@app.command("list")
def list_descriptions() -> None:
    """Name the bundled scanner descriptions."""
    for name in bundled_scanners():
        found = load_scanner(name)
        typer.echo(f"{name}: {found.title}, {found.layout.points.count} points, {found.baud_rate} baud")


@app.command("try")
def try_out(
    file: Annotated[str, typer.Argument(help="A scanner description (.yaml), or the name of a bundled one.")],
    device: Annotated[str, typer.Option(help="The serial device.")],
    baud: Annotated[int | None, typer.Option(help="Baud rate; default: the description's.")] = None,
    seconds: Annotated[float | None, typer.Option(help="End after this time; default: at Ctrl-C.")] = None,
) -> None:
    """Switch the laser on and show the profiles that are decoded. Exit code 3 when the device does not answer."""
    description = load_scanner(file)
    scanner = _scanner(file, device, baud or description.baud_rate)
    console = Console()
    scanner.open()
    try:
        scanner.start()
        live = Live(console=console, auto_refresh=False) if console.is_terminal else nullcontext(None)
        with live as display:
            _watch(scanner, seconds, lambda seen, health: _show(console, display, description, seen, health))
        scanner.stop()
    except KeyboardInterrupt:
        pass
    finally:
        scanner.close()


def _scanner(file: str, device: str, baud: int) -> Scanner:
    """The driver that a site with this scanner would get; arm and charger of that site are not opened."""
    site = SiteConfig()
    changed = site.scanner.model_copy(update={"format": file, "device": device, "baud_rate": baud})
    return build_devices(site.model_copy(update={"scanner": changed}), NullSink(), MonotonicClock()).scanner


def _watch(scanner: Scanner, seconds: float | None, show: Callable[[list[Profile], LinkHealth], None]) -> None:
    """Take profiles and show them every _REFRESH_S until the time is over."""
    end_s = time.monotonic() + (seconds if seconds is not None else float("inf"))
    while (now_s := time.monotonic()) < end_s:
        time.sleep(min(_REFRESH_S, end_s - now_s))
        show(scanner.take(), scanner.health())


def _show(
    console: Console, live: Live | None, description: ScannerDescription, seen: list[Profile], health: LinkHealth
) -> None:
    facts = _facts(seen) | {name: str(count) for name, count in health.counters}
    if live is None:
        console.print("  ".join(f"{name} {value}" for name, value in facts.items()), soft_wrap=True, highlight=False)
        return
    table = Table(title=description.title or description.name, show_header=False)
    for name, value in facts.items():
        table.add_row(name, value)
    live.update(table, refresh=True)


def _facts(seen: list[Profile]) -> dict[str, str]:
    """What a person wants to know of the newest profiles."""
    if not seen:
        return {"profiles": "none"}
    last = seen[-1]
    facts = {
        "profiles": f"{len(seen) / _REFRESH_S:.0f}/s",
        "number": str(last.sequence),
        "device time": "none" if last.device_time_s is None else f"{last.device_time_s:.3f} s",
        "points": f"{len(last.points)} ({last.quality:.0%} of the samples)",
    }
    if len(last.points):
        (x0, z0), (x1, z1) = last.points.min(axis=0) * 1e3, last.points.max(axis=0) * 1e3
        facts |= {"x": f"{x0:.1f} to {x1:.1f} mm", "z": f"{z0:.1f} to {z1:.1f} mm"}
    return facts
