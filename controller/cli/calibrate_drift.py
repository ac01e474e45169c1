"""``portdock calibrate drift``: does docking still end where it used to?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from controller.calibrations.dock_log import NAME, LoggedDock, in_words, read_docks
from controller.cli.scan import ConfigOption
from controller.config import load_config
from perception.calibration.drift import AXES, ChartSettings, Dock, chart, warnings

UNITS = np.array([1e3] * 3 + [180.0 / np.pi] * 3)


def drift(
    out: Annotated[Path | None, typer.Option(help="Draw the charts into this picture (.png, .svg).")] = None,
    config: ConfigOption = None,
) -> None:
    """Print the control chart of every port type docked at with the newest calibrations, and what it warns of.

    Exit code 1 with a warning.
    """
    folder = Path(load_config(config).calibration.folder)
    logged = read_docks(folder)
    if not logged:
        typer.echo(f"{folder / NAME}: no docks yet")
        return
    docks = [one.dock for one in logged if one.basis == logged[-1].basis]
    for port in sorted({dock.port for dock in docks}):
        _print_port(port, [dock for dock in docks if dock.port == port])
    if out is not None:
        _draw(docks, out)
        typer.echo(out)
    found = warnings(docks)
    for warning in found:
        typer.echo(in_words(warning))
    older = len(logged) - len(docks)
    if older:
        typer.echo(f"{older} docks with other calibrations are left out, the last on {_last_other(logged)}")
    if found:
        raise typer.Exit(1)


def _print_port(port: str, docks: list[Dock]) -> None:
    found, baseline = chart(docks), ChartSettings().baseline
    if found is None:
        typer.echo(f"{port}: {len(docks)} docks; the chart judges from {baseline + 1} on")
        return
    typer.echo(f"{port}: {len(docks)} docks, the first {baseline} are the standard")
    rows = zip(AXES, found.average[-1], found.centre, found.bound[-1], UNITS, found.alarms[-1], strict=True)
    for axis, average, centre, bound, unit, alarmed in rows:
        state = "OUT OF BOUNDS" if alarmed else "ok"
        name = "mm" if unit == UNITS[0] else "deg"
        typer.echo(f"  {axis:12} {unit * (average - centre):+7.3f} {name} of +-{unit * bound:.3f}  {state}")


def _draw(docks: list[Dock], path: Path) -> None:
    """One row a port, one chart an axis."""
    from matplotlib.figure import Figure  # takes a second to import

    charts = {port: chart([dock for dock in docks if dock.port == port]) for port in sorted({d.port for d in docks})}
    judged = {port: found for port, found in charts.items() if found is not None}
    figure = Figure(figsize=(15, 2.6 * max(1, len(judged))), layout="constrained")
    panels = figure.subplots(max(1, len(judged)), len(AXES), squeeze=False)
    for row, (port, found) in zip(panels, judged.items(), strict=False):
        for k, (panel, axis) in enumerate(zip(row, AXES, strict=True)):
            dock = np.arange(len(found.average)) + ChartSettings().baseline + 1
            panel.plot(dock, UNITS[k] * (found.average[:, k] - found.centre[k]), ".-")
            for sign in (-1.0, 1.0):
                panel.plot(dock, sign * UNITS[k] * found.bound[:, k], color="tab:red", linewidth=0.8)
            panel.set(title=f"{port}: {axis}", xlabel="dock", ylabel="mm" if k < 3 else "deg")
    figure.savefig(path, dpi=100)


def _last_other(logged: list[LoggedDock]) -> str:
    return max(one.time for one in logged if one.basis != logged[-1].basis).strftime("%Y-%m-%d")
