"""Table 1 with ours beside the paper's, and the tables that it needs to be understood: Markdown and CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO

from perception.evaluation import statistics
from perception.evaluation.cells import Cell, Cells
from perception.evaluation.methods import CONTROL_ROUNDS, METHODS, Method
from perception.evaluation.records import MergeRecord, Record, SplitRecord
from perception.evaluation.statistics import Estimate
from perception.evaluation.trials import ALL_CONDITIONS, COMPLETE, MANY_OUTLIERS, PARTIAL, Condition


@dataclass(frozen=True, slots=True)
class Table:
    """A table as text."""

    name: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """GitHub's Markdown."""
        lines = [self.header, tuple("---" for _ in self.header), *self.rows]
        return "\n".join("| " + " | ".join(row) + " |" for row in lines) + "\n"

    def csv(self) -> str:
        """Comma separated."""
        text = StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([self.header, *self.rows])
        return text.getvalue()


@dataclass(frozen=True, slots=True)
class _Claim:
    """A row of the paper's Table 1: improvement over baseline 1 and baseline 2, in percent."""

    index: str
    paper_b1: float
    paper_b2: float
    condition: Condition
    smaller_is_better: bool


_CLAIMS = (
    _Claim("loss against registrations", 58.73, 66.89, COMPLETE, True),
    _Claim("recognition success", 21.28, 33.70, COMPLETE, False),
    _Claim("loss at 65 % integrity", 57.34, 63.85, PARTIAL, True),
    _Claim("IOU", 43.54, 55.46, COMPLETE, False),
)


_COMPARED = (
    ("one start", ("literal", "faithful", "robust-1"), "b1"),
    ("28 starts", ("literal-28", "faithful-28", "robust"), "b1-28"),
    ("global", ("o3d-ransac-icp", "o3d-fgr-icp"), "b1"),
)
"""Rows of Table 1 with the baseline 1 that starts where they do; baseline 2 and the yardsticks need no start."""


def table_1(cells: Cells) -> Table:
    """Relative improvement of each profile over the baselines. Loss on medians after the last registration."""
    rows = []
    for claim in _CLAIMS:
        for starts, names, b1 in _COMPARED:
            for name in names:
                own, *others = (cells.get(claim.condition.name, each) for each in (name, b1, "b2"))
                if own is not None:
                    title = name.removesuffix("-28").removesuffix("-1")
                    rows.append((claim.index, starts, title, *_claimed(claim, own, others)))
    header = (
        "index", "starts", "method", "paper vs B1", "ours vs B1", "paper vs B2", "ours vs B2",
        "values: method, B1, B2", "ms: method, B1, B2",
    )  # fmt: skip
    return Table("table-1", header, tuple(rows))


def _claimed(claim: _Claim, own: Cell, others: Sequence[Cell | None]) -> tuple[str, ...]:
    """What Table 1 says of a method against baseline 1 and baseline 2."""
    found = (own, *others)
    values = ", ".join("-" if cell is None else _short(_measure(claim, cell)) for cell in found)
    if claim.index == "IOU":
        values += f" (ceiling {_short(own.of_trials(lambda t: t.ceiling_raw).value)})"
    spent = ["-" if cell is None else f"{cell.of_trials(lambda t: t.total_ms).value:.0f}" for cell in found]
    return (
        f"{claim.paper_b1:.2f} %",
        _improvement(claim, own, others[0]),
        f"{claim.paper_b2:.2f} %",
        _improvement(claim, own, others[1]),
        values,
        ", ".join(spent),
    )


def _measure(claim: _Claim, cell: Cell) -> float:
    if claim.index == "recognition success":
        return cell.success().value
    return cell.iou_raw().value if claim.index == "IOU" else cell.loss_median().value


def _improvement(claim: _Claim, own: Cell, other: Cell | None) -> str:
    """Relative, and for shares the difference in points as well."""
    if other is None:
        return "-"
    ours, theirs = _measure(claim, own), _measure(claim, other)
    if theirs == 0:
        return "baseline at 0"
    gain = (theirs - ours) / theirs if claim.smaller_is_better else (ours - theirs) / theirs
    points = "" if claim.smaller_is_better else f" ({100 * (ours - theirs):+.0f} points)"
    return f"{100 * gain:+,.1f} %{points}"


def all_cells(cells: Cells) -> Table:
    """Every cell: what was measured, nothing left out."""
    header = (
        "condition", "group", "method", "trials", "registrations", "loss median (mm2)", "95 % interval",
        "loss mean (mm2)", "within 2 deg & 2 mm", "95 % interval of that", "within 5 deg & 5 mm",
        "IOU raw", "ceiling raw", "IOU cleaned", "ceiling cleaned", "IOU raw at 2 s", "ceiling at 2 s",
        "IOU raw at 5 s", "ceiling at 5 s", "angle median (deg)", "centre median (mm)", "ms per registration",
        "ms in all", "R MSE", "R RMSE", "R MAE", "t MSE (mm2)", "t RMSE (mm)", "t MAE (mm)",
    )  # fmt: skip
    rows = []
    for condition in ALL_CONDITIONS:
        for method in METHODS:
            cell = cells.get(condition.name, method.name)
            if cell is not None:
                rows.append(_cell_row(condition, method, cell))
    return Table("cells", header, tuple(rows))


def _cell_row(condition: Condition, method: Method, cell: Cell) -> tuple[str, ...]:
    loss, success = cell.loss_median(), cell.success()
    return (
        condition.name,
        method.group,
        method.name,
        str(len(cell.trials)),
        str(max(len(trial.rounds) for trial in cell.trials)),
        _short(loss.value),
        _interval(loss),
        _short(cell.loss_mean().value),
        _short(success.value),
        _interval(success),
        _short(cell.success(within=5.0).value),
        _short(cell.iou_raw().value),
        _short(cell.of_trials(lambda t: t.ceiling_raw).value),
        _short(cell.iou_clean().value),
        _short(cell.of_trials(lambda t: t.ceiling_clean).value),
        _short(cell.of_trials(lambda t: t.iou_fine).value),
        _short(cell.of_trials(lambda t: t.ceiling_fine).value),
        _short(cell.of_trials(lambda t: t.iou_coarse).value),
        _short(cell.of_trials(lambda t: t.ceiling_coarse).value),
        _short(cell.of_trials(lambda t: t.last.angle_deg).value),
        _short(cell.of_trials(lambda t: t.last.centre_mm).value),
        f"{cell.ms_per_round.value:.0f}",
        f"{cell.of_trials(lambda t: t.total_ms).value:.0f}",
        *(_short(entry.value) for entry in cell.entries()),
    )


def condition_table(cells: Cells, condition: Condition) -> Table:
    """One condition, methods grouped by their starts."""
    header = (
        "starts", "method", "trials", "loss median (mm²) [95 %]", "loss mean (mm²)", "within 2°/2 mm [95 %]",
        "within 5°/5 mm", "IOU raw / ceiling", "IOU cleaned / ceiling", "ms per registration", "ms in all",
    )  # fmt: skip
    rows = []
    for method in METHODS:
        cell = cells.get(condition.name, method.name)
        if cell is None or method.group == "control":
            continue
        loss, success = cell.loss_median(), cell.success()
        rows.append(
            (
                method.group,
                method.title,
                str(len(cell.trials)),
                f"{_short(loss.value)} [{_interval(loss)}]",
                _short(cell.loss_mean().value),
                f"{success.value:.2f} [{_interval(success)}]",
                f"{cell.success(within=5.0).value:.2f}",
                f"{cell.iou_raw().value:.3f} / {cell.of_trials(lambda t: t.ceiling_raw).value:.3f}",
                f"{cell.iou_clean().value:.3f} / {cell.of_trials(lambda t: t.ceiling_clean).value:.3f}",
                f"{cell.ms_per_round.value:.0f}",
                f"{cell.of_trials(lambda t: t.total_ms).value:.0f}",
            )
        )
    return Table(condition.name, header, tuple(rows))


def controls_table(cells: Cells) -> Table:
    """What the feedback does, against controls that take its place; all after the same number of registrations."""
    rows = []
    for condition in (COMPLETE, MANY_OUTLIERS):
        for method in METHODS:
            cell = cells.get(condition.name, method.name)
            if cell is None or (method.group != "control" and method.name not in ("faithful", "robust")):
                continue
            k = CONTROL_ROUNDS
            loss = cell.loss_median(k)
            rows.append(
                (
                    condition.title,
                    method.title,
                    str(len(cell.trials)),
                    f"{_short(loss.value)} [{_interval(loss)}]",
                    _short(cell.loss_mean(k).value),
                    f"{cell.success(k).value:.2f}",
                    f"{cell.iou_clean(k).value:.3f}",
                )
            )
    header = ("condition", "method", "trials", "loss median (mm²) [95 %]", "loss mean", "within 2°/2 mm", "IOU cleaned")
    return Table("controls", header, tuple(rows))


def split_table(records: Sequence[Record]) -> Table:
    """What the tree's split rule changes."""
    rows = []
    for rule in ("std", "cycle", "extent"):
        found = [r for r in records if isinstance(r, SplitRecord) and r.rule == rule]
        if found:
            rows.append(
                (
                    rule,
                    str(len(found)),
                    "identical" if all(r.same_neighbours and r.same_masks for r in found) else "DIFFERENT",
                    str(max(r.depth for r in found)),
                    f"{statistics.median([r.nodes_visited for r in found]).value:.1f}",
                )
            )
    return Table("split-rule", ("split rule", "trials", "quality", "depth", "nodes visited per query"), tuple(rows))


def merge_table(records: Sequence[Record]) -> Table:
    """How well views are merged without a model: each view against truth, the first being the reference, then all."""
    merges = [r for r in records if isinstance(r, MergeRecord) and r.view > 0]
    views = sorted({r.view for r in merges})
    rows = []
    for step in ("sequential", "joint"):
        found = [r for r in merges if r.step == step]
        for name, chosen in (*((str(v + 1), [r for r in found if r.view == v]) for v in views), ("all", found)):
            if chosen:
                rows.append((step, name, *_merge_errors(chosen)))
    header = (
        "step", "view", "trials", "angle median (deg)", "95 % interval", "centre median (mm)", "95 % interval of that",
        "centre worst (mm)",
    )  # fmt: skip
    return Table("merge", header, tuple(rows))


def _merge_errors(records: Sequence[MergeRecord]) -> tuple[str, ...]:
    angle, centre = (statistics.median([getattr(r, name) for r in records]) for name in ("angle_deg", "centre_mm"))
    return (
        str(len({r.trial for r in records})),
        _short(angle.value),
        _interval(angle),
        _short(centre.value),
        _interval(centre),
        _short(max(r.centre_mm for r in records)),
    )


def _short(value: float) -> str:
    if value == 0:
        return "0"
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.2e}"


def _interval(estimate: Estimate) -> str:
    return f"{_short(estimate.low)} to {_short(estimate.high)}"
