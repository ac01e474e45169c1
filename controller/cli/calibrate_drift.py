"""``portdock calibrate drift``: does docking still end where it used to, and what would put it back?"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from controller.calibrations.corrections import Correction, corrections
from controller.calibrations.dock_log import NAME, LoggedDock, cell_mark, in_words, judged, read_docks
from controller.calibrations.in_force import basis_of, calibrated_as_far_as_fits, device_names, mock_names, usable
from controller.calibrations.record import DeviceNames
from controller.calibrations.store import CalibrationStore
from controller.cli.scan import ConfigOption
from controller.config import SiteConfig, load_config
from controller.mock_calibrations import KEPT_NAME, as_calibrated, cell_name
from controller.scenarios import check_name
from perception.calibration.drift import AXES, ChartSettings, Dock, Drift, chart, warnings
from perception.errors import InputError

UNITS = np.array([1e3] * 3 + [180.0 / np.pi] * 3)


def drift(
    out: Annotated[Path | None, typer.Option(help="Draw the charts into this picture (.png, .svg).")] = None,
    accept: Annotated[
        str | None, typer.Option(help="Put this proposal in force: hand-eye, tool or port-NAME. Nothing moves.")
    ] = None,
    config: ConfigOption = None,
    mock_cell: Annotated[
        int | None, typer.Option(min=0, help="Docks of this mock cell. Plain dry runs' need no number.")
    ] = None,
    scenario: Annotated[str, typer.Option(help="With --mock-cell: of which scenario.")] = "nominal",
) -> None:
    """Print the control chart of every port type docked at, what it warns of, and which correction would cancel it.

    Exit code 1 with a warning, 0 once a correction has been accepted.
    """
    check_name(scenario)
    site = load_config(config)
    folder = Path(site.calibration.folder)
    logged = read_docks(folder)
    mocks = _mocks(site, scenario, mock_cell, logged)
    if not logged and accept is not None:
        raise InputError(f"there are no docks in {folder / NAME}: nothing is proposed", remedy="Dock some times first.")
    if not logged:
        typer.echo(f"{folder / NAME}: no docks yet")
        return
    current = judged(logged, logged[-1].basis)
    docks = [one.dock for one in current]
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
        typer.echo(f"{older} docks with other calibrations are left out")
    if accept is not None:
        _accept(accept, _proposed(site, mocks, found, logged[-1]), CalibrationStore(folder))
    elif found:
        try:
            _show(_proposed(site, mocks, found, logged[-1]))
        except InputError as error:  # the warning stands all the same
            typer.echo(f"no correction: {error.cause}\n  remedy: {error.remedy}")
        raise typer.Exit(1)


def _mocks(site: SiteConfig, scenario: str, mock_cell: int | None, logged: Sequence[LoggedDock]) -> DeviceNames | None:
    """The mock cell that docked, None for the site's own devices."""
    if mock_cell is not None:
        return mock_names(cell_name(site, scenario, mock_cell, mock_cell))
    return mock_names(KEPT_NAME) if logged and logged[-1].basis.startswith(KEPT_NAME) else None


def _proposed(
    site: SiteConfig, mocks: DeviceNames | None, found: Sequence[Drift], last: LoggedDock
) -> list[Correction]:
    """Raises InputError if other calibrations than the docks' are in force: they may have mended it already."""
    devices = mocks or device_names(site)
    if devices.scanner == KEPT_NAME:
        site = as_calibrated(site)
    site, examined = calibrated_as_far_as_fits(site, devices)
    if mocks is not None:
        site = site.model_copy(update={"scanner": site.scanner.model_copy(update={"serial": devices.scanner})})
    if cell_mark(basis_of(site)) != cell_mark(last.basis):
        raise InputError(
            "the docks in the chart were made with other calibrations than those in force",
            remedy="Dock with these first; the chart judges anew. Docks of a mock cell want --mock-cell.",
        )
    return list(corrections(site, found, usable(examined), devices, datetime.now(UTC)))


def _show(proposed: Sequence[Correction]) -> None:
    for one in proposed:
        typer.echo(f"proposed: {one.new.slot} by {_change(one)}\n  `portdock calibrate drift --accept {one.new.slot}`")
    if len(proposed) > 1:
        typer.echo("accept one of them: docks alone do not tell which has moved")


def _change(one: Correction) -> str:
    place, turn = 1e3 * one.change[:3], np.rad2deg(one.change[3:])
    return f"{' '.join(f'{v:+.3f}' for v in place)} mm, {' '.join(f'{v:+.3f}' for v in turn)} deg"


def _accept(slot: str, proposed: Sequence[Correction], store: CalibrationStore) -> None:
    """The old one is a file too before the new one is in force."""
    chosen = next((one for one in proposed if one.new.slot == slot), None)
    if chosen is None:
        known = ", ".join(one.new.slot for one in proposed) or "nothing"
        raise InputError(f"the chart proposes no correction of '{slot}'", remedy=f"Proposed is {known}.")
    before = store.path_in_force(slot) if chosen.stored else store.add(chosen.old)
    assert before is not None, "what is stored is in force"
    path = store.add(chosen.new)
    typer.echo(f"{slot} corrected by {_change(chosen)}")
    typer.echo(f"in force: {path}\n  undo with `portdock calibrate restore {before.name}`")


def _print_port(port: str, docks: list[Dock]) -> None:
    found, baseline = chart(docks), ChartSettings().baseline
    if found is None:
        typer.echo(f"{port}: {len(docks)} docks; the chart judges from {baseline + 1} on")
        return
    typer.echo(f"{port}: {len(docks)} docks, the first {found.standard} are the standard")
    state = "OUT OF BOUNDS" if found.alarms[-1] else "ok"
    typer.echo(f"  all axes together {found.distance[-1]:.1f} standard deviations off, of {found.limit:.1f}  {state}")
    rows = zip(AXES, found.shift[-1], found.sigma[-1], UNITS, found.shifted[-1], strict=True)
    for axis, shift, sigma, unit, shifted in rows:
        state = "shifted" if shifted else ""
        name = "mm" if unit == UNITS[0] else "deg"
        typer.echo(f"  {axis:12} {unit * shift:+7.3f} {name}, sigma {unit * sigma:.3f}  {state}".rstrip())


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
            panel.plot(dock, UNITS[k] * found.shift[:, k], ".-")
            for sign in (-1.0, 1.0):
                bound = sign * found.limit * UNITS[k] * found.sigma[:, k]
                panel.plot(dock, bound, color="tab:red", linewidth=0.8)
            panel.set(title=f"{port}: {axis}", xlabel="dock", ylabel="mm" if k < 3 else "deg")
    figure.savefig(path, dpi=100)
