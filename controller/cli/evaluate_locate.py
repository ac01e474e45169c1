"""``portdock evaluate locate``: success, accuracy, time, refusals and calibration of the locator, beside its peers."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from perception.errors import InputError

if TYPE_CHECKING:
    from perception.evaluation.locate_folder import FolderCase
    from perception.evaluation.locate_runner import LocatePlan
    from perception.port_shape import PortShape

_TIERS = "easy,nominal,hard,extreme"


def evaluate_locate(
    out: Annotated[Path, typer.Option(help="folder for results; a stopped run is taken up again")],
    scans: Annotated[int, typer.Option(min=0, help="positive scans: ports and tiers in turn")] = 32,
    negatives: Annotated[int | None, typer.Option(min=0, help="scans to be refused; as many as --scans")] = None,
    loose: Annotated[int, typer.Option(min=0, help="nominal scans of parts that are off their CAD")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="below 1000: for tuning; from 1000 on: for acceptance")] = 1,
    tiers: Annotated[str, typer.Option(help="with commas between")] = _TIERS,
    ports: Annotated[
        str, typer.Option(help="with commas between; by default all bundled ones, and one of other code")
    ] = "",
    peers: Annotated[str, typer.Option(help="peers with commas between, or all; those not installed are named")] = "",
    peer_scans: Annotated[int, typer.Option(min=1, help="positive scans that peers are run on")] = 40,
    also: Annotated[
        str, typer.Option(help="no-prior; auto: all models; denoised, keypoints, keypoints-alone, fed-back: see docs")
    ] = "",
    folder: Annotated[Path | None, typer.Option("--dir", help="scans with truth instead of simulated ones")] = None,
    jobs: Annotated[int, typer.Option(min=0, help="processes; 0: one for each core")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="print the figures as one JSON object")] = False,
) -> None:
    """Evaluate the default locator on simulated scans, or on a folder of scans with their truth."""
    from controller.reports.locate_evaluation import write_evaluation_page
    from perception.evaluation import locate_runner
    from perception.evaluation.locate_solvers import EXTRAS
    from perception.evaluation.locate_write_up import as_values, write_results

    names, skipped = _peers(peers)
    shapes = _shapes(ports)
    if folder is None:
        plan = _simulated(seed, scans, scans if negatives is None else negatives, loose, _tiers(tiers), shapes)
    else:
        plan = _from_folder(folder, seed, shapes)
    plan = _with_solvers(plan, names, peer_scans, _listed(also, EXTRAS, "--also"))
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("scans", total=None)
        results = locate_runner.run(
            plan,
            out,
            jobs or os.cpu_count() or 1,
            lambda done, total: progress.update(bar, completed=done, total=total),
        )
    notes = (*_about(), *skipped)
    written = write_results(results, plan, out, notes)
    page = write_evaluation_page(out / "index.html", results, plan, notes)
    if as_json:
        typer.echo(json.dumps(as_values(results, plan, notes)))
    else:
        for path in (*written, page):
            typer.echo(path)


def _shapes(ports: str) -> dict[str, PortShape]:
    from controller.port_files import bundled_ports, load_port
    from perception.evaluation.families import OTHERS

    known = (*bundled_ports(), *OTHERS)
    names = _listed(ports, known, "--ports") or known
    return {name: OTHERS[name] if name in OTHERS else load_port(name).shape for name in names}


def _tiers(text: str) -> tuple[str, ...]:
    names = _listed(text, tuple(_TIERS.split(",")), "--tiers")
    if not names:
        raise InputError("--tiers names no tier", remedy=f"Use some of {_TIERS}.")
    return names


def _simulated(
    seed: int, scans: int, negatives: int, loose: int, tiers: Sequence[str], shapes: Mapping[str, PortShape]
) -> LocatePlan:
    from perception.evaluation.locate_cases import each_tier, loose_cases, negative_cases, positive_cases
    from perception.evaluation.locate_runner import LocatePlan

    chosen = tuple(each_tier(tiers))
    cases = positive_cases(scans, list(shapes), chosen) + negative_cases(negatives, shapes, chosen)
    return LocatePlan(seed, (*cases, *loose_cases(loose, list(shapes))), shapes)


def _from_folder(folder: Path, seed: int, shapes: Mapping[str, PortShape]) -> LocatePlan:
    from perception.evaluation.locate_folder import folder_cases
    from perception.evaluation.locate_runner import LocatePlan

    entries = folder_cases(folder)
    _check_models(entries, shapes)
    return LocatePlan(seed, (), shapes, folder=tuple(entries))


def _check_models(entries: Sequence[FolderCase], shapes: Mapping[str, PortShape]) -> None:
    for entry in entries:
        if entry.mesh is None and entry.case.asked not in shapes:
            raise InputError(
                f"{entry.scan.name} shows a {entry.case.asked!r}, of which there is no model",
                remedy=f"Put its mesh into {entry.scan.parent.name}/ports, or name one of {', '.join(shapes)}.",
            )


def _with_solvers(plan: LocatePlan, peers: tuple[str, ...], peer_scans: int, extras: tuple[str, ...]) -> LocatePlan:
    from dataclasses import replace

    return replace(plan, peers=peers, peer_scans=peer_scans, extras=extras)


def _peers(text: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Peers that can be run, and a line for each that cannot."""
    from perception.evaluation.locate_peers import PEERS

    names = tuple(PEERS) if text == "all" else _listed(text, tuple(PEERS), "--peers")
    present = tuple(name for name in names if PEERS[name].present)
    missing = [PEERS[name] for name in names if name not in present]
    notes = tuple(f"Skipped: {peer.name}, for its library {peer.library} is not installed." for peer in missing)
    for note in notes:
        typer.echo(f"{note} pip install 'portdock[peers]' brings it.", err=True)
    return present, notes


def _listed(text: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(",") if part.strip())
    for name in names:
        if name not in known:
            raise InputError(f"{option}: {name!r} is not known", remedy=f"Known: {', '.join(known)}.")
    return names


def _about() -> tuple[str, ...]:
    """The command and the version that ran."""
    from importlib.metadata import version

    command = " ".join(["portdock", *sys.argv[1:]])
    commit = _commit()
    return (f"Command: {command}", f"portdock {version('portdock')}{f', commit {commit}' if commit else ''}.")


def _commit() -> str:
    """Commit of the working tree that portdock runs from; empty for an installed package."""
    import subprocess

    here = Path(__file__).parent
    try:
        found = subprocess.run(
            ["git", "-C", str(here), "describe", "--always", "--dirty"],
            check=False,
            capture_output=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip() if found.returncode == 0 else ""
