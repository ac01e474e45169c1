"""The report's pictures, drawn with matplotlib's Agg and SVG back ends: facts in, bytes of a picture out.

Drawing needs no display and leaves no state behind, but matplotlib's style is global while a picture is drawn: one
report at a time in a process.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controller.reports.facts import Alignment, InsertionTrace, StateSpan
from perception.geometry import Array

INK, MUTED, GRID = "#1d2733", "#6b7785", "#e3e7ec"
SCAN, MODEL = "#2171b5", "#e6762b"
FORCE, LATERAL, DEPTH = "#c0392b", "#8e6bb0", "#2171b5"
STATE_COLOURS = {
    "STAGING": "#9db4c8",
    "SCANNING": "#4f9d9a",
    "LOCATING": "#2171b5",
    "APPROACHING": "#9db4c8",
    "INSERTING": "#e6762b",
    "VERIFYING": "#e9b44c",
    "CHARGING": "#3a9a5b",
    "RELEASING": "#a3c585",
    "RETREATING": "#9db4c8",
    "HOLD": "#e9b44c",
    "FAULT": "#c0392b",
}
_OTHER_STATE = "#cdd5dd"
_STYLE: Any = {
    "font.size": 9.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
    "svg.hashsalt": "portdock",
}
_MAX_POINTS = 40_000


def timeline(spans: Sequence[StateSpan]) -> bytes:
    """States over time as a stepped bar: one row for each state that was entered. SVG."""
    rows = list(dict.fromkeys(span.state for span in spans))
    with styled(10.0, 0.9 + 0.24 * len(rows)) as figure:
        axes = figure.add_subplot()
        end_s = max(spans[-1].end_s, 1e-6)
        for span in spans:
            row = rows.index(span.state)
            width = max(span.end_s - span.start_s, 0.003 * end_s)
            axes.barh(row, width, left=span.start_s, height=0.72, color=STATE_COLOURS.get(span.state, _OTHER_STATE))
        for row, state in enumerate(rows):
            stays = [span for span in spans if span.state == state]
            total = sum(span.end_s - span.start_s for span in stays)
            right = max(span.end_s for span in stays)
            axes.annotate(f"{total:.1f} s", (right, row), xytext=(5, 0), **_BESIDE, color=MUTED, fontsize=8)
        axes.set_yticks(range(len(rows)), rows, color=INK)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlim(0, 1.06 * end_s)
        axes.set_xlabel("time since start, s")
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        return picture(figure, "svg")


def aligned_views(alignment: Alignment) -> bytes:
    """The scan with the model drawn at the estimated pose: into the port, and a section along its axis. PNG."""
    scan, model = 1e3 * alignment.scan, 1e3 * alignment.model
    with styled(10.0, 5.0) as figure:
        front, side = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
        for points, colour, name, size in ((model, MODEL, "port model", 1.2), (scan, SCAN, "scan", 2.0)):
            shown = _thinned(points)
            front.scatter(shown[:, 0], shown[:, 1], s=size, color=colour, linewidths=0, alpha=0.55, label=name)
            cut = _thinned(points[np.abs(points[:, 0]) < _half_section(points)])
            side.scatter(cut[:, 2], cut[:, 1], s=2.2 * size, color=colour, linewidths=0, alpha=0.75)
        label(front, "looking into the port", "x, mm (right)", "y, mm (up)")
        label(side, "section along the axis", "z, mm (out of the vehicle)", "y, mm (up)")
        front.legend(loc="upper left", markerscale=5, bbox_to_anchor=(0.0, -0.1), ncols=2)
        return picture(figure, "png")


def residuals(alignment: Alignment) -> bytes:
    """Distance of each scan point from the model's surface: as a map, and as a histogram. PNG."""
    near = alignment.near
    points, distance = 1e3 * alignment.scan[near], 1e3 * alignment.distance_m[near]
    far = _thinned(1e3 * alignment.scan[~near])
    order = np.argsort(distance)  # the worst points on top
    with styled(10.0, 4.6) as figure:
        chart, histogram = figure.subplots(1, 2, width_ratios=[1.35, 1.0])
        chart.scatter(far[:, 0], far[:, 1], s=1.0, color="#d5dbe1", linewidths=0)
        drawn = chart.scatter(
            *(points[order, 0], points[order, 1]),
            c=distance[order],
            s=2.2,
            linewidths=0,
            cmap="viridis",
            vmin=0,
            vmax=1,
        )
        label(chart, "distance from the model's surface", "x, mm", "y, mm")
        bar = figure.colorbar(drawn, ax=chart, extend="max", shrink=0.8)
        bar.set_label("mm")
        histogram.hist(distance, bins=60, range=(0, 2.0), color=SCAN)
        if len(distance):
            for share, name in ((50, "median"), (95, "95 %")):
                value = float(np.percentile(distance, share))
                histogram.axvline(value, color=MODEL, linewidth=1.2)
                note = f" {name} {value:.2f} mm"
                histogram.annotate(note, (value, 0.97 - 0.07 * (share == 95)), xycoords=_DATA_AND_AXES, color=INK)
        histogram.set_xlim(0, 2.0)
        histogram.set_title("points by distance", loc="left")
        histogram.set_xlabel("mm (points farther than 2 mm are grey on the left)")
        return picture(figure, "png")


def force_over_depth(traces: Sequence[InsertionTrace]) -> bytes:
    """Axial force over depth, one line for each attempt. SVG."""
    with styled(4.9, 3.6) as figure:
        axes = figure.add_subplot()
        shades = np.linspace(0.45, 1.0, len(traces)) if len(traces) > 1 else np.ones(1)
        for trace, shade in zip(traces, shades, strict=True):
            depth, force = _spaced(trace.depth_mm), _spaced(trace.axial_n)
            name = f"attempt {trace.attempt}"
            axes.plot(depth, force, color=FORCE, alpha=float(shade), linewidth=1.3, label=name)
            axes.plot(depth[-1], force[-1], "o", color=FORCE, alpha=float(shade), markersize=4)
        axes.axvline(0.0, color=MUTED, linewidth=0.8, linestyle="--")
        axes.annotate(" rim plane", (0.0, 0.97), xycoords=_DATA_AND_AXES, color=MUTED, fontsize=8, va="top")
        label(axes, "force over depth", "depth of the plug, mm", "axial force, N", equal=False)
        if len(traces) > 1:
            axes.legend()
        return picture(figure, "svg")


def force_over_time(traces: Sequence[InsertionTrace]) -> bytes:
    """Depth, axial and lateral force over time, all attempts. SVG."""
    with styled(4.9, 3.6) as figure:
        depth_axes, force_axes = figure.subplots(2, 1, sharex=True)
        for k, trace in enumerate(traces):
            time_s = _spaced(trace.time_s)
            names = ("axial", "lateral") if k == 0 else (None, None)
            depth_axes.plot(time_s, _spaced(trace.depth_mm), color=DEPTH, linewidth=1.3)
            force_axes.plot(time_s, _spaced(trace.axial_n), color=FORCE, linewidth=1.1, label=names[0])
            force_axes.plot(time_s, _spaced(trace.lateral_n), color=LATERAL, linewidth=1.1, label=names[1])
        label(depth_axes, "depth and force over time", "", "depth, mm", equal=False)
        label(force_axes, "", "time since start, s", "force, N", equal=False)
        force_axes.legend(ncols=2, loc="upper left")
        return picture(figure, "svg")


_BESIDE: dict[str, Any] = {"textcoords": "offset points", "va": "center"}
_DATA_AND_AXES: Any = ("data", "axes fraction")


@contextmanager
def styled(width_in: float, height_in: float) -> Iterator[Figure]:
    """An empty figure in the reports' style, which holds while it is drawn and saved."""
    with mpl.rc_context(_STYLE):
        yield Figure(figsize=(width_in, height_in), layout="constrained")


def picture(figure: Figure, kind: Literal["png", "svg"]) -> bytes:
    """The figure as a file's bytes."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else None
    figure.savefig(buffer, format=kind, dpi=160, metadata=metadata)
    return buffer.getvalue()


def label(axes: Axes, title: str, x: str, y: str, *, equal: bool = True) -> None:
    """Title and axis names; ``equal``: a millimetre is as long on both axes."""
    axes.set_title(title, loc="left")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if equal:
        axes.set_aspect("equal", adjustable="datalim")


def _thinned(points: Array) -> Array:
    """At most ``_MAX_POINTS`` of them, spread evenly over the array."""
    return points[:: max(1, len(points) // _MAX_POINTS)]


def _spaced(values: Array) -> Array:
    """At most 2,000 samples, the last one kept: more cannot be told apart on paper."""
    step = max(1, len(values) // 2000)
    return np.append(values[::step], values[-1])


def _half_section(points: Array) -> float:
    """Half the thickness of the section, mm: thin where there are points enough."""
    return 2.0 if len(points) > 5000 else 4.0
