"""Figures 4 to 8 of the paper with our numbers: PNG and SVG, shaded or barred by 95 % bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from perception.evaluation.cells import Cell, Cells
from perception.evaluation.methods import method
from perception.evaluation.statistics import Estimate
from perception.evaluation.trials import COMPLETE, INTEGRITIES, integrity_condition

_SHOWN = ("literal", "faithful", "robust-1", "robust", "b1", "b2", "o3d-ransac-icp")
_COLOURS = {
    "literal": "#999999",
    "faithful": "#0072b2",
    "robust-1": "#56b4e9",
    "robust": "#009e73",
    "b1": "#d55e00",
    "b2": "#cc79a7",
    "o3d-ransac-icp": "#000000",
    "o3d-fgr-icp": "#f0e442",
}


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


def _axes(width: float = 6.4, height: float = 3.9) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.grid(alpha=0.3)
    return figure, axes


def _line(axes: Any, x: list[float], estimates: list[Estimate], name: str, dashed: bool = False) -> None:
    colour = _COLOURS.get(name, "#666666")
    style = "--" if dashed else "-"
    axes.plot(x, [e.value for e in estimates], style, color=colour, marker=".", label=_label(name))
    axes.fill_between(x, [e.low for e in estimates], [e.high for e in estimates], color=colour, alpha=0.15, lw=0)


def _label(name: str) -> str:
    entry = method(name)
    return f"{entry.title} (28 starts)" if entry.group == "28 starts" else entry.title


def _over_rounds(cells: Cells, statistic: Callable[[Cell, int], Estimate], label: str, *, log: bool) -> Figure:
    """Figures 4 and 5: complete scans, over the number of registrations."""
    figure, axes = _axes()
    rounds = list(range(1, COMPLETE.rounds + 1))
    for name in _SHOWN:
        cell = cells.get(COMPLETE.name, name)
        if cell is not None:
            _line(axes, [float(k) for k in rounds], [statistic(cell, k) for k in rounds], name, name == "robust")
    axes.set_xlabel("registrations")
    axes.set_ylabel(label)
    if log:
        axes.set_yscale("log")
    axes.set_title(f"complete scans, start 20°/15 mm, {_trials(cells)}", fontsize=9)
    axes.legend(fontsize=7)
    return figure


def _over_integrity(cells: Cells) -> Figure:
    """Figure 6: loss and success over the integrity of the scan, after five registrations at most."""
    figure = Figure(figsize=(9.4, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name in _SHOWN:
        row = [(p, cells.get(integrity_condition(p).name, name)) for p in INTEGRITIES]
        found = [(100 * p, cell) for p, cell in row if cell is not None]
        if not found:
            continue
        x = [p for p, _ in found]
        _line(left, x, [cell.loss_median(5) for _, cell in found], name, name == "robust")
        _line(right, x, [cell.success(5) for _, cell in found], name, name == "robust")
    for axes, label in ((left, "median loss (mm²)"), (right, "within 2° and 2 mm")):
        axes.set_xlabel("integrity (%)")
        axes.set_ylabel(label)
        axes.invert_xaxis()
        axes.grid(alpha=0.3)
    left.set_yscale("log")
    figure.legend(*left.get_legend_handles_labels(), fontsize=7, ncols=4, loc="outside lower center")
    figure.suptitle(f"one side cut off, after 5 registrations, {_trials(cells)}", fontsize=9)
    return figure


def _entries(cells: Cells) -> Figure:
    """Figure 7: MSE, RMSE and MAE of the entries of R and t, complete scans."""
    figure = Figure(figsize=(9.4, 3.7), layout="constrained")
    shown = [name for name in _SHOWN if cells.get(COMPLETE.name, name) is not None]
    entries = {name: cells.need(COMPLETE.name, name).entries() for name in shown}
    for axes, offset, title in zip(
        figure.subplots(1, 2), (0, 3), ("rotation entries", "translation (mm)"), strict=True
    ):
        for i, name in enumerate(shown):
            place = np.arange(3) + (i - len(shown) / 2) * 0.8 / len(shown)
            values = entries[name][offset : offset + 3]
            axes.bar(place, values, 0.8 / len(shown), color=_COLOURS[name], label=_label(name))
        axes.set_xticks(np.arange(3), ["MSE (19)", "RMSE (20)", "MAE (21)"])
        axes.set_yscale("log")
        axes.set_title(f"{title}, {_trials(cells)}", fontsize=9)
        axes.grid(alpha=0.3, axis="y")
    figure.axes[0].legend(fontsize=6)
    return figure


def _iou(cells: Cells) -> Figure:
    """Figure 8: occupancy IOU of the cleaned scan over registrations, with the ceiling at the true pose."""
    figure = _over_rounds(cells, Cell.iou_clean, "IOU of the cleaned scan", log=False)
    axes = figure.axes[0]
    cell = cells.get(COMPLETE.name, "robust")
    if cell is not None:
        ceiling = cell.of_trials(lambda trial: trial.ceiling_clean).value
        axes.axhline(ceiling, color="#009e73", lw=0.8, ls=":")
        axes.text(1.0, ceiling, " ceiling: robust's cleaned scan at the true pose", fontsize=7, va="bottom")
        raw = cell.of_trials(lambda trial: trial.ceiling_raw).value
        axes.axhline(raw, color="#000000", lw=0.8, ls=":")
        axes.text(1.0, raw, " ceiling: whole scan at the true pose", fontsize=7, va="top")
    return figure


def _trials(cells: Cells) -> str:
    counts = {len(cell.trials) for cell in cells.cells}
    return f"{min(counts)} trials" if len(counts) == 1 else f"{min(counts)} to {max(counts)} trials"
