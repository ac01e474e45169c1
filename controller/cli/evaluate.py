"""``portdock evaluate``: the published method's figures and table, ours beside the paper's; the locator."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from controller.cli.evaluate_calibration import evaluate_calibration
from controller.cli.evaluate_locate import evaluate_locate
from controller.cli.evaluate_views import evaluate_views

app = typer.Typer(help="Measure how well ports are located, against baselines and truth.", no_args_is_help=True)
app.command("locate")(evaluate_locate)
app.command("calibration")(evaluate_calibration)
app.command("views")(evaluate_views)


@app.command("method")
def method(
    out: Annotated[Path, typer.Option(help="folder for figures, table and results; a stopped run is taken up again")],
    trials: Annotated[int, typer.Option(min=1, help="scans in each cell")] = 30,
    quick: Annotated[bool, typer.Option("--quick", help="few scans and conditions, within three minutes")] = False,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    jobs: Annotated[int, typer.Option(min=0, help="processes; 0: one for each core")] = 0,
    port: Annotated[str, typer.Option(help="bundled port that the evaluation is run on")] = "ccs2",
    second_port: Annotated[str, typer.Option(help="bundled port that no default was chosen on")] = "type2",
) -> None:
    """Regenerate Figures 4 to 8 and Table 1 of the published method, with baselines and controls."""
    from controller.port_files import load_port
    from perception.evaluation import runner

    out.mkdir(parents=True, exist_ok=True)  # before the bar is drawn: an error is two lines
    ports = load_port(port).shape, load_port(second_port).shape
    plan = runner.quick_plan(ports, seed) if quick else runner.full_plan(ports, seed, trials)
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    ) as progress:
        bar = progress.add_task("trials", total=None)
        results = runner.run(
            plan,
            out,
            jobs or os.cpu_count() or 1,
            lambda done, total: progress.update(bar, completed=done, total=total),
        )
    from perception.evaluation.write_up import write_results

    for path in write_results(results, plan, out):
        typer.echo(path)
