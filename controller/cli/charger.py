"""``portdock charger``: the CAN contract as a page, and its traffic live or from a recording."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from controller.cli.charger_contract import describe as describe_contract
from controller.wiring import CanTraffic, can_traffic
from perception.errors import InputError

app = typer.Typer(help="The charger's CAN contract and its traffic.", no_args_is_help=True)
_REFRESH_S = 0.2


@app.command()
def describe(
    dbc: Annotated[Path | None, typer.Option(help="Another DBC than the bundled one.")] = None,
) -> None:
    """Print the CAN contract as Markdown: messages, signals, protection, rules (docs/can.md)."""
    print(describe_contract(dbc), end="")


@app.command()
def monitor(
    channel: Annotated[str | None, typer.Option(help="Channel of the interface: a tty, can0, ...")] = None,
    file: Annotated[Path | None, typer.Option(help="A recording instead: candump .log, .blf or .asc.")] = None,
    interface: Annotated[str, typer.Option(help="Any of python-can's interfaces.")] = "slcan",
    bitrate: Annotated[int, typer.Option(help="Bit rate of the bus.")] = 250_000,
    dbc: Annotated[Path | None, typer.Option(help="Another DBC than the bundled one.")] = None,
    protection: Annotated[str, typer.Option(help="none, counter, j1850, e2e-p11 or e2e-p5.")] = "e2e-p11",
    seconds: Annotated[float | None, typer.Option(help="End after this time.")] = None,
) -> None:
    """Show the contract's messages decoded, with the health of each. Listens only; sends nothing."""
    if (channel is None) == (file is None):
        raise InputError("monitor needs either --channel or --file", remedy="portdock charger monitor --help")
    traffic = can_traffic(channel, file, interface, bitrate, dbc, protection, seconds)
    console = Console()
    if not console.is_terminal or file is not None:
        with suppress(KeyboardInterrupt):
            for _ in traffic.listen():
                pass
        console.print(_table(traffic))
        return
    with Live(_table(traffic), console=console, auto_refresh=False) as live, suppress(KeyboardInterrupt):
        for _ in _every(_REFRESH_S, traffic.listen()):
            live.update(_table(traffic), refresh=True)


def _every(period_s: float, ticks: Iterator[None]) -> Iterator[None]:
    """Thin out: at most one in each period."""
    next_s = 0.0
    for _ in ticks:
        if time.monotonic() >= next_s:
            next_s = time.monotonic() + period_s
            yield None


def _table(traffic: CanTraffic) -> Table:
    table = Table(title=f"{traffic.foreign} foreign frames, {traffic.errors} error frames", title_justify="left")
    table.add_column("message", no_wrap=True)
    table.add_column("health", no_wrap=True)
    for heading in ("frames", "period", "bad", "repeated", "astray", "missed", "newest"):
        table.add_column(heading, overflow="fold")
    for row in traffic.health():
        period = "" if row.period_s is None else f"{1000.0 * row.period_s:.0f} of {1000.0 * row.cycle_s:.0f} ms"
        newest = ", ".join(f"{name} {value}" for name, value in row.values)
        counts = (row.bad_checksum + row.unreadable, row.repeated, row.wrong_sequence, row.missed)
        note = f" ({row.suspicion})" if row.suspicion else ""
        table.add_row(row.name, row.state, str(row.frames), period, *(str(n) for n in counts), newest + note)
    return table
