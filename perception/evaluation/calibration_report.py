"""``evaluate calibration``: the trials of all seeds in parallel, and the table that they come to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import beta, binom

from perception.calibration.errors import CalibrationError
from perception.evaluation.calibration_trials import (
    CARS,
    DriftTrial,
    HandEyeTrial,
    Placed,
    PlacingTrial,
    drift_trial,
    hand_eye_trial,
    placing_trials,
)
from perception.evaluation.processes import workers

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Row:
    """One figure with its interval and what it is to be."""

    what: str
    value: str
    interval: str
    bar: str
    met: bool


@dataclass(frozen=True, slots=True)
class Trials:
    """What all seeds came to."""

    hand_eye: Sequence[HandEyeTrial]
    arm: Sequence[PlacingTrial]
    """With an arm whose zeros and lengths are off."""
    everything: Sequence[PlacingTrial]
    """With all errors."""
    drift: Sequence[DriftTrial]


def run_trials(runs: int, jobs: int, report: Progress) -> Trials:
    """``runs`` hand-eye calibrations, twice three tenths as many erring cells, four times as many drift charts."""
    seeds, cells = range(runs), range(max(2, 3 * runs // 10))
    with workers(jobs) as pool:
        solved = [pool.submit(_hand_eye_or_none, seed) for seed in seeds]
        arm, everything = ([pool.submit(_placing, seed, all_errors) for seed in cells] for all_errors in (False, True))
        waiting: list[Future[Any]] = [*solved, *arm, *everything]
        for done, _ in enumerate(as_completed(waiting), 1):
            report(done, len(waiting))
        return Trials(
            [trial for future in solved if (trial := future.result()) is not None],
            [trial for future in arm for trial in future.result()],
            [trial for future in everything for trial in future.result()],
            [drift_trial(seed) for seed in range(4 * runs)],
        )


def _hand_eye_or_none(seed: int) -> HandEyeTrial | None:
    try:
        return hand_eye_trial(seed)
    except CalibrationError:
        return None


def _placing(seed: int, everything: bool) -> list[PlacingTrial]:
    """Empty for a cell that cannot be calibrated."""
    try:
        return placing_trials(seed, everything)
    except CalibrationError:
        return []


def rows(runs: int, trials: Trials) -> list[Row]:
    """The figures of issue and docs: quantiles with 95 % intervals by order statistics, shares with exact ones."""
    hand_eye, drift = trials.hand_eye, trials.drift
    inside = sum(trial.inside_95 for trial in hand_eye)
    quick = sum(trial.docks_to_warning is not None and trial.docks_to_warning <= 5 for trial in drift)
    silent = sum(not trial.false_alarm for trial in drift)
    return [
        _share("hand-eye calibrations that were solved", len(hand_eye), runs, 1.0, 1.0),
        _quantile("hand-eye position, perfect arm", [t.error_mm for t in hand_eye], 0.95, 0.1, "mm"),
        _quantile("hand-eye rotation, perfect arm", [t.error_deg for t in hand_eye], 0.95, 0.05, "deg"),
        _share("truth inside the stated 95 % ellipsoid", inside, len(hand_eye), 0.90, 0.98),
        _quantile("the same position, its errors estimated too", [t.with_arm_mm for t in hand_eye], 0.95, None, "mm"),
        *_placing_rows("arm with errors", trials.arm, located_mm=0.5, median_mm=0.33, most_mm=0.6, share=None),
        *_placing_rows("all errors", trials.everything, located_mm=0.5, median_mm=0.33, most_mm=0.6, share=0.99),
        _share("bumps of 0.5 mm, 0.3 deg warned of within 5 docks", quick, len(drift), 0.95, 1.0),
        _share("charts without false alarm in 500 docks", silent, len(drift), 0.95, 1.0),
    ]


def _placing_rows(
    cell: str,
    placing: Sequence[PlacingTrial],
    *,
    located_mm: float | None,
    median_mm: float | None,
    most_mm: float | None,
    share: float | None,
) -> list[Row]:
    """Located, then placed without and after teaching; bars are for the median, and after teaching. None: reported."""
    if not placing:
        return []
    cells = placing[::CARS]
    inside = sum(one.inside_95 for one in cells)
    return [
        _quantile(f"port located in the base, {cell}", [t.located_mm for t in placing], 0.5, located_mm, "mm"),
        replace(
            _share(f"true mounting inside the stated 95 % ellipsoid, {cell}", inside, len(cells), 0.9, 1.0),
            bar="reported",
            met=True,
        ),
        _quantile(f"its 1 sigma as stated, {cell}", [t.stated_mm for t in placing], 0.5, None, "mm"),
        _quantile(f"located, the arm at its word, {cell}", [t.located_ideal_mm for t in placing], 0.5, None, "mm"),
        *_placed(f"without teaching, {cell}", [t.untaught for t in placing], None, None, None),
        *_placed(f"after teaching, {cell}", [t.taught for t in placing], median_mm, most_mm, share),
    ]


def _placed(
    when: str, placed: Sequence[Placed], median_mm: float | None, most_mm: float | None, share: float | None
) -> list[Row]:
    captured = _share(
        f"first tries within capture {when}", sum(p.captured for p in placed), len(placed), share or 0.0, 1.0
    )
    return [
        _quantile(f"plug placed {when}", [p.off_mm for p in placed], 0.5, median_mm, "mm"),
        _quantile(f"plug placed {when}", [p.off_mm for p in placed], 0.95, most_mm, "mm"),
        captured if share is not None else replace(captured, bar="reported", met=True),
    ]


def _quantile(what: str, values: Sequence[float], share: float, bar: float | None, unit: str) -> Row:
    ordered, count = np.sort(np.asarray(values)), len(values)
    value = float(np.quantile(ordered, share))
    low, high = (int(binom.ppf(tail, count, share)) for tail in (0.025, 0.975))
    interval = f"{ordered[max(0, low - 1)]:.3f} to {ordered[min(count - 1, high)]:.3f} {unit}"
    name = "median" if share == 0.5 else f"{share:.0%} quantile"
    wanted = "reported" if bar is None else f"<= {bar:g} {unit}"
    return Row(f"{what}, {name} of {count}", f"{value:.3f} {unit}", interval, wanted, bar is None or value <= bar)


def _share(what: str, good: int, count: int, low: float, high: float) -> Row:
    if count == 0:
        return Row(what, "0/0", "-", f"{low:.0%} to {high:.0%}", False)
    least = 0.0 if good == 0 else float(beta.ppf(0.025, good, count - good + 1))
    most = 1.0 if good == count else float(beta.ppf(0.975, good + 1, count - good))
    met = low <= good / count <= high
    return Row(what, f"{good}/{count}", f"{least:.1%} to {most:.1%}", f"{low:.0%} to {high:.0%}", met)


def table(found: Sequence[Row], runs: int) -> str:
    """Markdown."""
    lines = [
        f"`portdock evaluate calibration --runs {runs}`: seeds from 0; {CARS} car positions (+-100 mm, +-10 deg each"
        " axis) for each cell with an erring arm; all errors: its sag and the scanner's clock too. What counts as"
        " within capture is in the port file of ccs2. Pure simulation: no wires, no outliers.",
        "",
        "| what | measured | 95 % interval | bar | met |",
        "|---|---|---|---|---|",
    ]
    lines += [f"| {r.what} | {r.value} | {r.interval} | {r.bar} | {'yes' if r.met else 'NO'} |" for r in found]
    return "\n".join(lines) + "\n"
