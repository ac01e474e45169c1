"""``portdock evaluate views``: what a second viewpoint gains where parts of the port are hidden."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from controller.cli.scan import show_quarters


def evaluate_views(
    out: Annotated[Path, typer.Option(help="Folder for views.md and views.jsonl.")],
    pairs: Annotated[int, typer.Option(min=1, help="Pairs of sweeps for each arm and integrity.")] = 24,
    seed: Annotated[int, typer.Option(min=0, help="Below 1000: for tuning; from 1000 on: for acceptance.")] = 1,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0: one for each core.")] = 0,
) -> None:
    """Locate pairs of cut sweeps alone, laid together by the arm, and registered; write the table."""
    from controller.port_files import bundled_ports, load_port
    from perception.evaluation.views_gain import run_pairs, table  # takes seconds to import

    out.mkdir(parents=True, exist_ok=True)
    shapes = {name: load_port(name).shape for name in bundled_ports()}
    trials = run_pairs(
        pairs, seed, shapes, jobs or os.cpu_count() or 1, lambda done, total: show_quarters("pairs", done / total, "")
    )
    (out / "views.jsonl").write_text("".join(json.dumps(asdict(trial)) + "\n" for trial in trials), encoding="utf-8")
    text = table(trials)
    (out / "views.md").write_text(text, encoding="utf-8")
    typer.echo(text)
