"""Figures 4 to 8 of the paper with our numbers: PNG and SVG, shaded or barred by 95 % bootstrap intervals."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from perception.evaluation.cells import Cell, Cells
from perception.evaluation.methods import method
from perception.evaluation.statistics import Estimate
from perception.evaluation.trials import COMPLETE, INTEGRITIES, integrity_condition

_PANELS = (
    ("one start", ("literal", "faithful", "robust-1", "b1")),
    (
        "28 starts, or global",
        ("literal-28", "faithful-28", "robust", "b1-28", "b2", "o3d-ransac", "o3d-ransac-icp", "o3d-fgr-icp"),
    ),
)
"""Within a panel all methods have the same starts, or need none."""
_COLOURS = {
    "literal": "#999999",
    "faithful": "#0072b2",
    "robust": "#009e73",
    "b1": "#d55e00",
    "b2": "#cc79a7",
    "o3d-ransac": "#56b4e9",
    "o3d-ransac-icp": "#000000",
    "o3d-fgr-icp": "#e69f00",
}
_GAP = Estimate(float("nan"), float("nan"), float("nan"), 0)
"""Where a method was not run its line is broken, not drawn across."""


def write_figures(cells: Cells, folder: Path) -> list[Path]:
    """All figures whose cells were run."""
    mpl.rcParams.update({"svg.hashsalt": "portdock", "font.size": 9, "svg.fonttype": "none"})
    made = (
        ("figure-4-loss", _over_rounds(cells, Cell.loss_median, "median loss (mm²)", log=True)),
        ("figure-5-success", _over_rounds(cells, Cell.success, "within 2° and 2 mm", log=False)),
        ("figure-6-integrity", _over_integrity(cells)),
        ("figure-7-entries", _entries(cells)),
        ("figure-8-iou", _iou(cells)),
    )
    return [path for name, figure in made for path in _save(figure, folder / name)]


def _save(figure: Figure, stem: Path) -> list[Path]:
    paths = [stem.with_suffix(".png"), stem.with_suffix(".svg")]
    figure.savefig(paths[0], dpi=110, metadata={"Software": None})
    figure.savefig(paths[1], metadata={"Date": None})
    return paths


def _base(name: str) -> str:
    """The method without its starts, which the panel names."""
    return name.removesuffix("-28").removesuffix("-1")


def _label(name: str) -> str:
    """Without what is said about the starts, so that both panels share one legend."""
    return re.split(r":|,| \(", method(name).title)[0]


def _line(axes: Any, x: Sequence[float], estimates: Sequence[Estimate], name: str) -> None:
    colour = _COLOURS[_base(name)]
    axes.plot(x, [e.value for e in estimates], color=colour, marker=".", label=_label(name))
    axes.fill_between(x, [e.low for e in estimates], [e.high for e in estimates], color=colour, alpha=0.15, lw=0)


def _panels(rows: int = 1, height: float = 3.9) -> tuple[Figure, Any]:
    """One row of two panels for each quantity; an array of axes (rows, 2)."""
    figure = Figure(figsize=(9.4, height), layout="constrained")
    axes = figure.subplots(rows, 2, sharex=True, sharey="row", squeeze=False)
    for one in axes.flat:
        one.grid(alpha=0.3)
    return figure, axes


def _finish(figure: Figure, axes: Any, title: str) -> None:
    """Panel titles, and one legend for all."""
    for one, (starts, _) in zip(axes[0], _PANELS, strict=True):
        one.set_title(starts, fontsize=9)
    handles: dict[str, Any] = {}
    for one in axes.flat:
        found, labels = one.get_legend_handles_labels()
        handles.update(zip(labels, found, strict=True))
    figure.legend(list(handles.values()), list(handles.keys()), fontsize=7, ncols=7, loc="outside lower center")
    figure.suptitle(title, fontsize=9)


def _over_rounds(cells: Cells, statistic: Callable[[Cell, int], Estimate], label: str, *, log: bool) -> Figure:
    """Figures 4, 5 and 8: complete scans, over the number of registrations."""
    figure, axes = _panels()
    rounds = list(range(1, COMPLETE.rounds + 1))
    for one, (_, names) in zip(axes[0], _PANELS, strict=True):
        for name in names:
            cell = cells.get(COMPLETE.name, name)
            if cell is not None:
                _line(one, rounds, [statistic(cell, k) for k in rounds], name)
        one.set_xlabel("registrations")
    axes[0, 0].set_ylabel(label)
    if log:
        axes[0, 0].set_yscale("log")
    _finish(figure, axes, f"complete scans, start 20°/15 mm, {_trials(cells, COMPLETE.name)}")
    return figure


def _over_integrity(cells: Cells) -> Figure:
    """Figure 6: loss and success over the integrity of the scan, after five registrations at most."""
    figure, axes = _panels(rows=2, height=6.4)
    quantities = (("median loss (mm²)", Cell.loss_median), ("within 2° and 2 mm", Cell.success))
    run = {cell.condition for cell in cells.cells}
    cuts = [(100 * p, integrity_condition(p).name) for p in INTEGRITIES if integrity_condition(p).name in run]
    for row, (label, statistic) in zip(axes, quantities, strict=True):
        for one, (_, names) in zip(row, _PANELS, strict=True):
            for name in names:
                found = [cells.get(condition, name) for _, condition in cuts]
                if any(found):
                    _line(one, [p for p, _ in cuts], [_GAP if c is None else statistic(c, 5) for c in found], name)
        row[0].set_ylabel(label)
    for one in axes[1]:
        one.set_xlabel("integrity (%)")
    axes[0, 0].invert_xaxis()
    axes[0, 0].set_yscale("log")
    trials = _trials(cells, *(condition for _, condition in cuts))
    _finish(figure, axes, f"one side cut off, after 5 registrations, {trials}")
    return figure


def _entries(cells: Cells) -> Figure:
    """Figure 7: MSE, RMSE and MAE of the entries of R and t, complete scans."""
    figure, axes = _panels(rows=2, height=6.4)
    for column, (_, names) in enumerate(_PANELS):
        shown = [(name, cells.need(COMPLETE.name, name)) for name in names if cells.get(COMPLETE.name, name)]
        for i, (name, cell) in enumerate(shown):
            place = np.arange(3) + (i - (len(shown) - 1) / 2) * 0.8 / len(shown)
            _bars(axes[:, column], place, 0.8 / len(shown), cell.entries(), name)
    for row, title in zip(axes, ("rotation entries", "translation entries (mm)"), strict=True):
        row[0].set_ylabel(title)
        row[0].set_yscale("log")
        row[0].set_xticks(np.arange(3), ["MSE (19)", "RMSE (20)", "MAE (21)"])
    _finish(figure, axes, f"complete scans, start 20°/15 mm, {_trials(cells, COMPLETE.name)}")
    return figure


def _bars(axes: Any, place: Any, width: float, entries: Sequence[Estimate], name: str) -> None:
    """Three bars of R in the upper axes, three of t in the lower, with their intervals."""
    for one, three in zip(axes, (entries[:3], entries[3:]), strict=True):
        value = np.array([e.value for e in three])
        span = np.abs(np.array([[e.low for e in three], [e.high for e in three]]) - value)
        style = {"color": _COLOURS[_base(name)], "label": _label(name)}
        one.bar(place, value, width, yerr=span, error_kw={"lw": 0.8, "ecolor": "#555555"}, **style)


def _iou(cells: Cells) -> Figure:
    """Figure 8: occupancy IOU of the cleaned scan over registrations, with the ceiling at the true pose."""
    figure = _over_rounds(cells, Cell.iou_clean, "IOU of the cleaned scan", log=False)
    cell = cells.get(COMPLETE.name, "robust")
    if cell is not None:
        clean = cell.of_trials(lambda trial: trial.ceiling_clean).value
        raw = cell.of_trials(lambda trial: trial.ceiling_raw).value
        for axes in figure.axes:
            axes.axhline(clean, color="#009e73", lw=0.8, ls=":")
            axes.axhline(raw, color="#000000", lw=0.8, ls=":")
        figure.axes[1].text(10.0, clean, "ceiling, robust's cleaned scan", fontsize=7, va="bottom", ha="right")
        figure.axes[1].text(10.0, raw, "ceiling, whole scan", fontsize=7, va="top", ha="right")
    return figure


def _trials(cells: Cells, *conditions: str) -> str:
    counts = {len(cell.trials) for cell in cells.cells if cell.condition in conditions} or {0}
    return f"{min(counts)} trials" if len(counts) == 1 else f"{min(counts)} to {max(counts)} trials"
