"""A run of the locator's evaluation -> one self-contained HTML page: figures, tables, calibration plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from controller.reports.html import address, render, write_page
from controller.reports.page import AMBER, GREEN, Tile
from perception.evaluation.locate_records import CaseRecord
from perception.evaluation.locate_runner import LocatePlan
from perception.evaluation.locate_solvers import PORTDOCK
from perception.evaluation.locate_summary import summary
from perception.evaluation.locate_tables import all_tables
from perception.evaluation.locate_write_up import calibration_plot, heading
from perception.evaluation.tables import Table


@dataclass(frozen=True, slots=True)
class EvaluationPage:
    """Everything the template prints."""

    headline: str
    tone: str
    lines: tuple[str, ...]
    tiles: tuple[Tile, ...]
    calibration: str
    tables: tuple[Table, ...]


def write_evaluation_page(
    target: Path, records: Sequence[CaseRecord], plan: LocatePlan, notes: Sequence[str] = ()
) -> Path:
    """Write the page to ``target``, replacing an older one. Raises ReportError."""
    ours = [r for r in records if r.solver == PORTDOCK]
    wrong = sum(r.false_accept for r in ours)
    page = EvaluationPage(
        headline=f"Locator: {summary(ours).success.hits} of {summary(ours).success.n} found, {wrong} wrongly accepted",
        tone=AMBER if wrong else GREEN,
        lines=heading(plan, notes),
        tiles=_tiles(ours),
        calibration=address("png", calibration_plot(records)),
        tables=tuple(all_tables(records)),
    )
    return write_page(target, render("locate_evaluation.html.j2", page))


def _tiles(records: Sequence[CaseRecord]) -> tuple[Tile, ...]:
    found = summary(records)
    return (
        Tile("found within 1 mm and 0.5°", f"{100 * found.success.value:.1f}", "%"),
        Tile("median error", f"{found.shift_median_mm:.3f}", "mm"),
        Tile("median error", f"{found.turn_median_deg:.3f}", "°"),
        Tile("over the Cramer-Rao bound", f"{found.shift_over_bound:.2f}", "mm/mm"),
        Tile("over the Cramer-Rao bound", f"{found.turn_over_bound:.2f}", "°/°"),
        Tile("time, median", f"{found.units_median:.1f}", "units"),
        Tile("right poses refused", f"{100 * found.false_refusals.value:.1f}", "%"),
        Tile("scans that must be refused", str(sum(not r.positive for r in records)), ""),
    )
