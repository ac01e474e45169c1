"""Everything that a run of the evaluation leaves behind: figures, tables and how they were made."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from perception.evaluation import tables
from perception.evaluation.cells import Cells
from perception.evaluation.figures import write_figures
from perception.evaluation.records import Record
from perception.evaluation.runner import Plan

_SUMMARY = "summary.md"


def write_results(records: Sequence[Record], plan: Plan, out: Path) -> list[Path]:
    """Figures 4 to 8, Table 1 as Markdown and CSV, every cell as CSV, and a summary; returns what was written."""
    cells = Cells.of(records)
    paths = write_figures(cells, out)
    one = tables.table_1(cells)
    extra = [tables.all_cells(cells), tables.controls_table(cells), tables.split_table(records)]
    extra.append(tables.merge_table(records))
    paths.append(_write(out / "table-1.md", one.markdown()))
    for table in (one, *extra):
        paths.append(_write(out / f"{table.name}.csv", table.csv()))
    paths.append(_write(out / _SUMMARY, _summary(records, cells, plan)))
    return paths


def _summary(records: Sequence[Record], cells: Cells, plan: Plan) -> str:
    counts = [len(cell.trials) for cell in cells.cells]
    ports = " and ".join(port.name for port in plan.ports)
    parts = [
        "# Results\n",
        f"Seed {plan.seed}; ports {ports}; {min(counts)} to {max(counts)} trials in each cell. Loss is the common loss"
        " (17) on fixed reference points; ms is processor time of one core. Intervals are 95 % bootstrap intervals.\n",
        "## Table 1\n",
        tables.table_1(cells).markdown(),
    ]
    for condition in plan.conditions:
        parts += [f"## {condition.title}\n", tables.condition_table(cells, condition).markdown()]
    for table in (tables.controls_table(cells), tables.split_table(records), tables.merge_table(records)):
        if table.rows:
            parts += [f"## {table.name}\n", table.markdown()]
    return "\n".join(parts)


def _write(path: Path, text: str) -> Path:
    path.write_text(text, "utf-8")
    return path
