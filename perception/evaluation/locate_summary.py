"""From answers to figures: success, accuracy, time, false accepts and refusals, calibration, by whatever group."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from perception.evaluation.locate_records import FALSE_M, FALSE_RAD, CaseRecord
from perception.evaluation.locate_statistics import Calibration, Share, calibration, quantile, share


@dataclass(frozen=True, slots=True)
class Summary:
    """Of positive scans. Lengths in mm and angles in degrees, as people compare them."""

    success: Share
    """Within 1 mm and 0.5 deg, accepted or not."""
    accepted: Share
    false_refusals: Share
    """Of the right poses, those refused."""
    false_accepts: int
    shift_median_mm: float
    shift_p95_mm: float
    turn_median_deg: float
    turn_p95_deg: float
    shift_over_bound: float
    """Median of error over Cramer-Rao bound, of the right poses."""
    turn_over_bound: float
    units_median: float
    """Wall time over the unit."""
    units_p95_over_median: float
    cpu_units_median: float
    """The same in processor time: less disturbed by what else the machine does."""
    seconds_median: float
    right_name: Share


def summary(records: Sequence[CaseRecord]) -> Summary:
    """Of the positive scans among ``records``, all of one solver."""
    records = [r for r in records if r.positive]
    right = [r for r in records if r.success]
    bounded = [r for r in right if np.isfinite(r.bound_m)]
    units = [r.wall_s / r.unit_wall_s for r in records]
    return Summary(
        success=share(len(right), len(records)),
        accepted=share(sum(r.accepted for r in records), len(records)),
        false_refusals=share(sum(r.false_refusal for r in records), len(right)),
        false_accepts=sum(r.false_accept for r in records),
        shift_median_mm=quantile([r.shift_m * 1e3 for r in records], 0.5),
        shift_p95_mm=quantile([r.shift_m * 1e3 for r in records], 0.95),
        turn_median_deg=quantile([float(np.rad2deg(r.turn_rad)) for r in records], 0.5),
        turn_p95_deg=quantile([float(np.rad2deg(r.turn_rad)) for r in records], 0.95),
        shift_over_bound=quantile([r.shift_m / r.bound_m for r in bounded], 0.5),
        turn_over_bound=quantile([r.turn_rad / r.bound_rad for r in bounded], 0.5),
        units_median=quantile(units, 0.5),
        units_p95_over_median=quantile(units, 0.95) / quantile(units, 0.5),
        cpu_units_median=quantile([r.cpu_s / r.unit_cpu_s for r in records], 0.5),
        seconds_median=quantile([r.wall_s for r in records], 0.5),
        right_name=share(sum(r.right_name for r in records), len(records)),
    )


def calibrated(records: Sequence[CaseRecord]) -> Calibration:
    """Over the positive scans whose pose is not grossly wrong: a covariance says nothing about another place."""
    near = [
        (r.error, r.covariance_matrix)
        for r in records
        if r.positive and r.shift_m <= FALSE_M and r.turn_rad <= FALSE_RAD and r.covariance_matrix is not None
    ]
    errors = np.array([error for error, _ in near]).reshape(-1, 6)
    return calibration(errors, np.array([matrix for _, matrix in near]).reshape(-1, 6, 6))


def grouped(records: Sequence[CaseRecord], key: Callable[[CaseRecord], str]) -> dict[str, list[CaseRecord]]:
    """Records by ``key``, groups in the order of their first record."""
    groups: dict[str, list[CaseRecord]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return groups
