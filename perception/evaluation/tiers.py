"""How hard a simulated scan is: the ranges from which the four tiers draw.

Easy: little noise, complete. Nominal: what a good site sees. Hard: clutter, noise, a third of the port missing.
Extreme: half of it missing. From nominal on the sweep's speed is not quite what the arm reports and the arm vibrates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

TierName = Literal["easy", "nominal", "hard", "extreme"]
Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Tier:
    """Ranges (smallest, largest) of what a scan of this tier suffers from."""

    noise_mm: Range
    outliers: Range
    integrity: Range
    """Share of the port's points that the cut leaves."""
    lateral_mm: Range
    along_mm: Range
    """Either sign."""
    tilt_deg: Range
    roll_deg: Range
    """Either sign."""
    patchiness: Range
    rays: Range
    """For each profile."""
    speed_error: float
    """1 sigma of the sweep's relative speed error."""
    vibration_mm: Range
    cover: float
    """Probability of an open cover in sight."""
    occluder: float
    """Probability of a cable, hand or box before the panel."""
    clutter: int
    """Largest number of trims beside the pocket."""


TIERS: dict[TierName, Tier] = {
    "easy": Tier(
        noise_mm=(0.05, 0.09),
        outliers=(0.0, 0.01),
        integrity=(0.97, 1.0),
        lateral_mm=(2.0, 10.0),
        along_mm=(0.0, 5.0),
        tilt_deg=(0.0, 5.0),
        roll_deg=(0.0, 5.0),
        patchiness=(0.1, 0.4),
        rays=(450, 700),
        speed_error=0.0,
        vibration_mm=(0.0, 0.0),
        cover=0.3,
        occluder=0.0,
        clutter=1,
    ),
    "nominal": Tier(
        noise_mm=(0.08, 0.20),
        outliers=(0.01, 0.05),
        integrity=(0.85, 1.0),
        lateral_mm=(5.0, 25.0),
        along_mm=(0.0, 12.0),
        tilt_deg=(2.0, 12.0),
        roll_deg=(0.0, 8.0),
        patchiness=(0.3, 0.7),
        rays=(400, 600),
        speed_error=0.001,
        vibration_mm=(0.01, 0.04),
        cover=0.5,
        occluder=0.15,
        clutter=1,
    ),
    "hard": Tier(
        noise_mm=(0.15, 0.35),
        outliers=(0.05, 0.12),
        integrity=(0.65, 0.85),
        lateral_mm=(15.0, 35.0),
        along_mm=(0.0, 20.0),
        tilt_deg=(5.0, 18.0),
        roll_deg=(2.0, 15.0),
        patchiness=(0.5, 0.9),
        rays=(400, 600),
        speed_error=0.003,
        vibration_mm=(0.02, 0.05),
        cover=0.6,
        occluder=0.45,
        clutter=2,
    ),
    "extreme": Tier(
        noise_mm=(0.25, 0.50),
        outliers=(0.10, 0.20),
        integrity=(0.50, 0.65),
        lateral_mm=(20.0, 40.0),
        along_mm=(0.0, 30.0),
        tilt_deg=(10.0, 20.0),
        roll_deg=(3.0, 15.0),
        patchiness=(0.6, 1.1),
        rays=(280, 500),
        speed_error=0.007,
        vibration_mm=(0.03, 0.08),
        cover=0.6,
        occluder=0.8,
        clutter=3,
    ),
}
"""Noise, outliers, integrity and offsets cover the ranges that a site's prior allows for (see ``estimate.Prior``)."""
