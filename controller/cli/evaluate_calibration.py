"""``portdock evaluate calibration``: how good hand-eye calibration, teaching and the drift chart are, in simulation."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from controller.cli.scan import show_quarters


def evaluate_calibration(
    out: Annotated[Path, typer.Option(help="Folder for calibration.md.")],
    runs: Annotated[int, typer.Option(min=5, help="Hand-eye calibrations; others in proportion.")] = 100,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0: one for each core.")] = 0,
) -> None:
    """Calibrate, teach and watch many drawn cells; write the table of what came out beside what is wanted."""
    from perception.evaluation.calibration_report import rows, run_trials, table  # takes a second to import

    out.mkdir(parents=True, exist_ok=True)
    trials = run_trials(
        runs, jobs or os.cpu_count() or 1, lambda done, total: show_quarters("trials", done / total, "")
    )
    text = table(rows(runs, trials), runs)
    (out / "calibration.md").write_text(text, encoding="utf-8")
    typer.echo(text)
