"""The evaluation's tables, as text. Every share comes as k/n with its exact 95 % interval."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from perception.evaluation.locate_ablation import VARIANTS
from perception.evaluation.locate_records import CaseRecord
from perception.evaluation.locate_solvers import AUTO, PORTDOCK
from perception.evaluation.locate_statistics import share
from perception.evaluation.locate_summary import Summary, calibrated, grouped, summary
from perception.evaluation.tables import Table

TIERS = ("easy", "nominal", "hard", "extreme")
_AXES = ("x", "y", "z", "rot x", "rot y", "rot z")
_DETAILS = (
    "success",
    "median mm",
    "p95 mm",
    "median deg",
    "p95 deg",
    "mm / bound",
    "deg / bound",
    "time, units",
    "p95 / median",
    "time, cpu units",
    "s",
    "right poses refused",
    "false accepts",
)


def all_tables(records: Sequence[CaseRecord]) -> list[Table]:
    """Every table that has rows."""
    ours = [r for r in records if r.solver == PORTDOCK]
    tables = [
        solver_table(records),
        detail_table(ours, "portdock by tier", "tier", lambda r: r.tier),
        detail_table(ours, "portdock by port", "port", lambda r: r.port),
        ablation_table(records),
        loose_table(ours),
        port_tier_table(ours),
        negative_table(ours),
        calibration_table(ours),
        identification_table(records),
        miss_table(ours),
    ]
    return [table for table in tables if table.rows]


def solver_table(records: Sequence[CaseRecord]) -> Table:
    """Success of every solver by tier, on the scans that it was given."""
    rows = []
    for name, answers in grouped([r for r in records if r.kind == "port"], lambda r: r.solver).items():
        by_tier = grouped(answers, lambda r: r.tier)
        whole = summary(answers)
        cells = [_count(by_tier.get(tier, [])) for tier in TIERS]
        rows.append((name, *cells, str(whole.success), f"{whole.units_median:.1f}", f"{whole.cpu_units_median:.1f}"))
    return Table("success", ("solver", *TIERS, "all", "time, units", "time, cpu units"), tuple(rows))


def _count(records: Sequence[CaseRecord]) -> str:
    return f"{sum(r.success for r in records)}/{len(records)}" if records else "-"


def detail_table(records: Sequence[CaseRecord], name: str, what: str, key: Callable[[CaseRecord], str]) -> Table:
    """All figures of each group of positive scans, and of all together."""
    positive = [r for r in records if r.kind == "port"]
    groups = grouped(positive, key)
    order = [*(k for k in TIERS if k in groups), *sorted(k for k in groups if k not in TIERS)]
    rows = [(group, *_details(summary(groups[group]))) for group in order]
    if positive:
        rows.append(("all", *_details(summary(positive))))
    return Table(name, (what, *_DETAILS), tuple(rows))


def loose_table(records: Sequence[CaseRecord]) -> Table:
    """Parts that are not quite their CAD."""
    loose = [r for r in records if r.kind == "loose-part"]
    rows = (("nominal", *_details(summary(loose))),) if loose else ()
    return Table("parts off their CAD", ("tier", *_DETAILS), rows)


def ablation_table(records: Sequence[CaseRecord]) -> Table:
    """The default beside itself with steps of the published method, on the scans that all of them were given."""
    by_solver = grouped([r for r in records if r.kind == "port"], lambda r: r.solver)
    names = [name for name in (PORTDOCK, *VARIANTS) if name in by_solver]
    if len(names) < 2:
        return Table("published steps", ("with", *_DETAILS), ())
    common = set.intersection(*({r.case for r in by_solver[name]} for name in names))
    rows = [(name, *_details(summary([r for r in by_solver[name] if r.case in common]))) for name in names]
    return Table("published steps", ("with", *_DETAILS), tuple(rows))


def _details(s: Summary) -> tuple[str, ...]:
    return (
        str(s.success),
        f"{s.shift_median_mm:.3f}",
        f"{s.shift_p95_mm:.3f}",
        f"{s.turn_median_deg:.3f}",
        f"{s.turn_p95_deg:.3f}",
        f"{s.shift_over_bound:.2f}",
        f"{s.turn_over_bound:.2f}",
        f"{s.units_median:.1f}",
        f"{s.units_p95_over_median:.1f}",
        f"{s.cpu_units_median:.1f}",
        f"{s.seconds_median:.2f}",
        str(s.false_refusals),
        str(s.false_accepts),
    )


def port_tier_table(records: Sequence[CaseRecord]) -> Table:
    """Success by port and tier."""
    rows = []
    for port, answers in sorted(grouped([r for r in records if r.kind == "port"], lambda r: r.port).items()):
        by_tier = grouped(answers, lambda r: r.tier)
        rows.append((port, *(_count(by_tier.get(tier, [])) for tier in TIERS)))
    return Table("success by port and tier", ("port", *TIERS), tuple(rows))


def negative_table(records: Sequence[CaseRecord]) -> Table:
    """What was accepted though it must not be, by kind; all accepted poses at the end."""
    rows = []
    for kind, answers in grouped([r for r in records if not r.positive], lambda r: r.kind).items():
        wrong = share(sum(r.false_accept for r in answers), len(answers))
        verdicts = ", ".join(f"{n} {name}" for name, n in Counter(r.verdict for r in answers).most_common())
        rows.append((kind, str(wrong), str(sum(r.accepted for r in answers)), verdicts))
    negative = [r for r in records if not r.positive]
    if negative:
        wrong = share(sum(r.false_accept for r in negative), len(negative))
        rows.append(("all negatives", str(wrong), str(sum(r.accepted for r in negative)), ""))
    accepted = [r for r in records if r.accepted]
    if accepted:
        rows.append(("wrong of all accepted", str(share(sum(r.false_accept for r in accepted), len(accepted))), "", ""))
    return Table("false accepts", ("scans", "wrongly accepted", "accepted", "verdicts"), tuple(rows))


def calibration_table(records: Sequence[CaseRecord]) -> Table:
    """How many errors the 95 % ellipsoid and each axis's own 95 % interval hold."""
    rows = []
    for tier, answers in grouped([r for r in records if r.kind == "port"], lambda r: r.tier).items():
        found = calibrated(answers)
        axes = (f"{one.value:.0%}" if one.n else "-" for one in found.axes_at(0.95))
        rows.append((tier, str(found.ellipsoid_at(0.95)), *axes))
    return Table("coverage of the 95 % covariance", ("tier", "ellipsoid", *_AXES), tuple(rows))


def identification_table(records: Sequence[CaseRecord]) -> Table:
    """Which port the locator names when it is given all models."""
    answers = [r for r in records if r.solver == AUTO]
    rows = []
    for tier, group in grouped([r for r in answers if r.kind == "port"], lambda r: r.tier).items():
        wrong = Counter(f"{r.port} as {r.named}" for r in group if not r.right_name)
        shown = ", ".join(f"{n} {name}" for name, n in wrong.most_common(6))
        rows.append((tier, str(share(sum(r.right_name for r in group), len(group))), shown))
    for kind, group in grouped([r for r in answers if not r.positive], lambda r: r.kind).items():
        named = Counter(r.named for r in group).most_common(4)
        rows.append((kind, "", ", ".join(f"{n} {name}" for name, n in named)))
    return Table("identification", ("scans", "right name", "named"), tuple(rows))


def miss_table(records: Sequence[CaseRecord]) -> Table:
    """Each scan that was not answered as it should be."""
    rows = []
    for r in records:
        what = [
            name
            for name, holds in (
                ("missed", r.positive and not r.success),
                ("false accept", r.false_accept),
                ("right pose refused", r.false_refusal),
            )
            if holds
        ]
        if what:
            shift = f"{r.shift_m * 1e3:.2f}" if r.error else "-"
            turn = f"{np.rad2deg(r.turn_rad):.2f}" if r.error else "-"
            rows.append((r.case, r.asked, ", ".join(what), shift, turn, "; ".join(r.reasons).replace("|", "/")))
    return Table("what went wrong", ("case", "asked", "what", "mm", "deg", "reasons"), tuple(rows))
