"""The residual picture of a hand-eye calibration: what every sweep is off the target, point by point."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from perception.calibration.from_sweeps import Solved
from perception.geometry import Array

MOST_POINTS = 400


def residual_picture(solved: Solved, left_out_m: Array, path: Path) -> None:
    """Left: residuals of each sweep; right: how far each sweep is from what all others foretell."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    points, sweeps = figure.subplots(1, 2, width_ratios=(3, 2))
    owner, residuals_um = solved.seen.sweep_of_point, 1e6 * solved.hand_eye.residuals_m
    numbers = np.unique(owner)
    for number in numbers:
        own = np.flatnonzero(owner == number)
        chosen = own[np.unique(np.linspace(0, len(own) - 1, MOST_POINTS).astype(int))]
        place = number + 1 + 0.8 * (np.linspace(0.0, 1.0, len(chosen)) - 0.5)
        points.plot(place, residuals_um[chosen], ".", markersize=2)
    points.axhline(0.0, color="0.5", linewidth=0.8)
    points.set_ylim(-600, 600)
    points.set(xlabel="sweep (within each: from its first profile to its last)", ylabel="distance from target (um)")
    sweeps.bar(numbers + 1, 1e3 * left_out_m)
    sweeps.set(xlabel="sweep", ylabel="off the place that the others foretell (mm)")
    figure.savefig(path, dpi=110)
