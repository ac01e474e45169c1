"""What a run of the locator's evaluation leaves behind: summary (Markdown, JSON), tables (CSV), calibration plot."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from perception.evaluation.locate_cases import seed_set
from perception.evaluation.locate_records import CaseRecord
from perception.evaluation.locate_runner import LocatePlan
from perception.evaluation.locate_solvers import PORTDOCK
from perception.evaluation.locate_statistics import LEVELS, Calibration
from perception.evaluation.locate_summary import calibrated, grouped, summary
from perception.evaluation.locate_tables import all_tables
from perception.evaluation.tables import Table

CALIBRATION = "calibration.png"


def write_results(records: Sequence[CaseRecord], plan: LocatePlan, out: Path, notes: Sequence[str] = ()) -> list[Path]:
    """Writes all files and returns their paths. ``notes``: lines about the run (what was skipped, which commit)."""
    tables = all_tables(records)
    paths = [out / f"{table.name.replace(' ', '-').replace('%', 'percent')}.csv" for table in tables]
    for path, table in zip(paths, tables, strict=True):
        path.write_text(table.csv(), "utf-8")
    for name, text in (
        ("summary.md", markdown(tables, plan, notes)),
        ("summary.json", json.dumps(as_values(records, plan, notes), indent=1) + "\n"),
    ):
        (out / name).write_text(text, "utf-8")
        paths.append(out / name)
    (out / CALIBRATION).write_bytes(calibration_plot(records))
    return [*paths, out / CALIBRATION]


def heading(plan: LocatePlan, notes: Sequence[str]) -> tuple[str, ...]:
    """Lines that say what was run."""
    source = f"scans of {plan.folder[0].scan.parent.name}" if plan.folder else "simulated scans"
    what = f"{len(plan.all_cases)} {source}, seed {plan.seed} ({seed_set(plan.seed)})."
    return what, "Success: within 1 mm and 0.5 deg, accepted or not. Unit: see locate_unit.", *notes


def markdown(tables: Sequence[Table], plan: LocatePlan, notes: Sequence[str]) -> str:
    """The summary as text."""
    parts = ["# Locator: results\n", "\n".join(heading(plan, notes)) + "\n"]
    for table in tables:
        parts += [f"## {table.name.capitalize()}\n", table.markdown()]
    return "\n".join(parts)


def as_values(records: Sequence[CaseRecord], plan: LocatePlan, notes: Sequence[str]) -> dict[str, Any]:
    """The summary for programs: each solver over all and by tier, false accepts, calibration."""
    solvers = {}
    for name, answers in grouped(records, lambda r: r.solver).items():
        tiers = grouped([r for r in answers if r.kind == "port"], lambda r: r.tier)
        solvers[name] = {
            "all": _plain(asdict(summary([r for r in answers if r.kind == "port"]))),
            "tiers": {tier: _plain(asdict(summary(group))) for tier, group in tiers.items()},
        }
    ours = [r for r in records if r.solver == PORTDOCK]
    negative = [r for r in ours if not r.positive]
    return {
        "seed": plan.seed,
        "seed_set": seed_set(plan.seed),
        "notes": list(notes),
        "solvers": solvers,
        "negatives": len(negative),
        "false_accepts": sum(r.false_accept for r in ours),
        "false_accepts_of_negatives": sum(r.false_accept for r in negative),
    }


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """What JSON can hold: numbers that are none become null."""
    plain: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            plain[key] = _plain(value)
        else:
            plain[key] = value if not isinstance(value, float) or np.isfinite(value) else None
    return plain


def calibration_plot(records: Sequence[CaseRecord]) -> bytes:
    """PNG: observed over predicted coverage of the ellipsoid and of each axis, one panel for each tier."""
    mpl.rcParams.update({"font.size": 8})
    ours = [r for r in records if r.solver == PORTDOCK and r.kind == "port"]
    tiers = grouped(ours, lambda r: r.tier) or {"no scans": []}
    figure = Figure(figsize=(2.6 * len(tiers), 2.7), layout="constrained")
    for axes, (tier, answers) in zip(figure.subplots(1, len(tiers), squeeze=False)[0], tiers.items(), strict=True):
        _panel(axes, tier, calibrated(answers))
    file = io.BytesIO()
    figure.savefig(file, dpi=90, metadata={"Software": None})
    return file.getvalue()


def _panel(axes: Any, tier: str, found: Calibration) -> None:
    axes.plot([0, 1], [0, 1], color="#999999", lw=0.8)
    whole = found.ellipsoid
    for k, name in enumerate(("x", "y", "z", "rot x", "rot y", "rot z")):
        axes.plot(LEVELS, [one.value for one in found.axes[k]], lw=0.9, alpha=0.8, label=name)
    low, high = [one.low for one in whole], [one.high for one in whole]
    axes.fill_between(LEVELS, low, high, color="#000000", alpha=0.12, lw=0)
    axes.plot(LEVELS, [one.value for one in whole], "k.-", label="ellipsoid")
    axes.set(title=f"{tier} (n = {whole[0].n})", xlabel="predicted", xlim=(0.45, 1.0), ylim=(0.0, 1.02))
    axes.grid(alpha=0.3)
    if tier in ("easy", "no scans"):
        axes.set_ylabel("observed")
        axes.legend(fontsize=6)
