"""``portdock campaign``: every fault in every state, each a fast dry run in a process of its own."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from controller.campaign.findings import Findings
from controller.campaign.rules import FAULTS, STATES, rule
from controller.campaign.table import as_html, as_markdown, verdict
from controller.cli.dry_run import FAST_FACTOR, Pace, for_mocks
from controller.config import SiteConfig, as_yaml, load_config
from controller.config_section import ConfigError
from controller.states import State

RESULT, SITE = "findings.json", "site.yaml"
LONGEST_S = 900.0
ATTEMPTS = 2
"""A cell whose mission ended before its fault was made (a busy computer spoils sweeps) is run once more."""


def campaign(
    out: Annotated[Path, typer.Option(help="Folder for the table and each cell's evidence; resumed if it exists.")],
    faults: Annotated[str, typer.Option(help="all, or names with commas: " + ", ".join(FAULTS) + ".")] = "all",
    states: Annotated[str, typer.Option(help="all, or names with commas.")] = "all",
    jobs: Annotated[int, typer.Option(min=1, help="Cells at once.")] = 1,
    pace: Pace = FAST_FACTOR,
    config: Annotated[Path | None, typer.Option(help="A site file; addresses are replaced by the mocks'.")] = None,
    cell: Annotated[str | None, typer.Option(hidden=True, help="Run one cell here: FAULT:STATE.")] = None,
) -> None:
    """Judge faults by the rules of controller/campaign/rules.py; exit 1 if a rule is broken or a cell did not run."""
    if cell is not None:
        fault, _, state = cell.partition(":")
        _run_here(fault, State[state], for_mocks(load_config(config), fast=True), out, pace)
        return
    chosen, at = _chosen(faults, tuple(FAULTS), "fault"), _chosen(states, tuple(s.name for s in STATES), "state")
    pairs = [(fault, State[name]) for fault in chosen for name in at]
    options = ["--pace", f"{pace:g}", *([] if config is None else ["--config", str(config)])]
    due = [pair for pair in pairs if not rule(*pair).impossible and not (_home(out, *pair) / RESULT).exists()]
    out.mkdir(parents=True, exist_ok=True)
    check_site(load_config(config), pace, out / SITE)
    with ThreadPoolExecutor(jobs) as pool:
        for (fault, step), _ in zip(due, pool.map(lambda pair: _run(pair[0], pair[1], out, options), due), strict=True):
            word, detail = verdict(fault, step, _results(out, pairs))
            print(f"{fault:<20} {step.name:<12} {word:<8} {detail}", flush=True)
    results, columns = _results(out, pairs), [State[name] for name in at]
    (out / "campaign.md").write_text(as_markdown(chosen, columns, results), encoding="utf-8")
    (out / "campaign.html").write_text(as_html(chosen, columns, results), encoding="utf-8")
    print(out / "campaign.md")
    if any(verdict(*pair, results)[0] in ("BROKEN", "not run") for pair in pairs):
        raise typer.Exit(1)


def _chosen(text: str, known: tuple[str, ...], what: str) -> list[str]:
    names = list(known) if text == "all" else [name.strip() for name in text.split(",")]
    for name in names:
        if name not in known:
            raise ConfigError(f"no {what} is called '{name}'", remedy=f"Use all, or some of {', '.join(known)}.")
    return names


def check_site(site: SiteConfig, pace: float, path: Path) -> None:
    """One table is of one site. Raises ConfigError where ``path`` names another."""
    text = f"# --pace {pace:g}\n{as_yaml(site)}"
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise ConfigError(
            f"{path.parent} holds cells of another site or pace",
            remedy="Give another --out, or their --config and --pace.",
        )
    path.write_text(text, encoding="utf-8")


def _home(out: Path, fault: str, state: State) -> Path:
    return out / fault / state.name.lower()


def _run(fault: str, state: State, out: Path, options: list[str]) -> None:
    """In a process of its own: what a fault does to a process must not reach the next cell."""
    home = _home(out, fault, state)
    for _ in range(ATTEMPTS):
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir(parents=True)
        command = [sys.executable, "-m", "controller.cli.main", "campaign", "--out", str(out), *options]
        with (home / "log.txt").open("w", encoding="utf-8") as log:
            process = subprocess.Popen(
                [*command, "--cell", f"{fault}:{state.name}"], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
            try:
                process.wait(LONGEST_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        found = _read(home)
        if found is not None and found.made:
            return


def _run_here(fault: str, state: State, site: SiteConfig, out: Path, pace: float) -> None:
    from controller.campaign.one_cell import run_cell  # devices take seconds to import

    home = _home(out, fault, state).resolve()
    findings = run_cell(fault, state, site, home, pace)
    (home / RESULT).write_text(json.dumps(asdict(findings)), encoding="utf-8")


def _read(home: Path) -> Findings | None:
    try:
        return Findings(**json.loads((home / RESULT).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _results(out: Path, pairs: list[tuple[str, State]]) -> dict[tuple[str, str], Findings]:
    found = {(fault, state.name): _read(_home(out, fault, state)) for fault, state in pairs}
    return {key: findings for key, findings in found.items() if findings is not None}
