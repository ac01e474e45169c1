"""``portdock calibrate show | budget | compare | restore``: the calibration files of a site."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from controller.calibrations.budget import budget_table
from controller.calibrations.in_force import device_names, slots_of, unfit
from controller.calibrations.record import CalibrationFileError
from controller.calibrations.store import CalibrationStore
from controller.calibrations.words import compared, described
from controller.config import SiteConfig, load_config
from perception.errors import InputError

ConfigOption = Annotated[Path | None, typer.Option(help="The site file.")]


def show(config: ConfigOption = None) -> None:
    """What is in force, how good it is, and which older files are kept."""
    site = load_config(config)
    store, now = CalibrationStore(Path(site.calibration.folder)), datetime.now(UTC)
    slots = store.slots()
    if not slots:
        typer.echo(f"{store.folder}: no calibration; the site file's own values are used")
    for slot in slots:
        _show(store, slot, site, now)


def _show(store: CalibrationStore, slot: str, site: SiteConfig, now: datetime) -> None:
    path = store.path_in_force(slot)
    try:
        calibration = store.in_force(slot)
    except CalibrationFileError as error:
        typer.echo(f"{slot}: {error.cause}\n  remedy: {error.remedy}")
        calibration = None
    if calibration is not None and path is not None:
        for line in described(calibration, path, now):
            typer.echo(line)
        problem = unfit(calibration, device_names(site), now, site.calibration.max_age_days)
        if problem is not None:
            typer.echo(f"  not used by this site: {problem.cause}")
    older = [file.name for file in store.files(slot) if path is None or file.name != path.name]
    if older:
        typer.echo("  kept: " + ", ".join(older))


def compare(
    old: Annotated[Path, typer.Argument(help="A calibration file.")],
    new: Annotated[Path | None, typer.Argument(help="Another; what is in force if left out.")] = None,
    config: ConfigOption = None,
) -> None:
    """How far two calibrations differ, and whether that is more than they are uncertain by."""
    store = CalibrationStore(Path(load_config(config).calibration.folder))
    first = store.read(_existing(old, store))
    second = store.in_force(first.slot) if new is None else store.read(_existing(new, store))
    if second is None or second.slot != first.slot:
        raise InputError(f"there is no other {first.slot} calibration to compare with", remedy="Name two files.")
    for line in compared(first, second):
        typer.echo(line)


def restore(
    file: Annotated[Path, typer.Argument(help="The file, as `portdock calibrate show` names it.")],
    config: ConfigOption = None,
) -> None:
    """Put an older calibration in force again. Its age counts on from the day that it was measured."""
    store = CalibrationStore(Path(load_config(config).calibration.folder))
    calibration = store.restore(file)
    typer.echo(f"in force for {calibration.slot}: {file.name}, measured {calibration.measured:%Y-%m-%d %H:%M}")


def budget(config: ConfigOption = None) -> None:
    """The error budget at the plug, from the calibrations in force and the locator's figures."""
    site = load_config(config)
    store = CalibrationStore(Path(site.calibration.folder))
    sound = {slot: one for slot in slots_of(site) if (one := store.in_force(slot)) is not None}
    for line in budget_table(sound, site.scan.standoff_mm):
        typer.echo(line)


def _existing(path: Path, store: CalibrationStore) -> Path:
    """The path as given, or a file of that name in the site's folder."""
    return path if path.exists() else store.folder / path.name
