"""What a process holds: memory, file descriptors, threads. And whether that grows."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

WARM_UP_SHARE = 0.2
LEAST_WARM_UP = 3
"""Missions before which caches fill and libraries allocate once."""


@dataclass(frozen=True, slots=True)
class Footprint:
    """What this process held at one moment."""

    rss_mb: float
    descriptors: int
    threads: int

    @staticmethod
    def now() -> Footprint:
        """Read from /proc."""
        status = Path("/proc/self/status").read_text(encoding="ascii")
        rss_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
        return Footprint(rss_kb / 1024.0, len(list(Path("/proc/self/fd").iterdir())), threading.active_count())


@dataclass(frozen=True, slots=True)
class Growth:
    """From the end of the warm-up to the end of the soak: medians of the first and last third."""

    rss_mb: float
    descriptors: float
    threads: float
    measured: int
    """Missions after the warm-up."""


def growth(footprints: Sequence[Footprint]) -> Growth | None:
    """None while there are too few missions to tell."""
    warm = max(LEAST_WARM_UP, int(WARM_UP_SHARE * len(footprints)))
    rest = np.array([(f.rss_mb, f.descriptors, f.threads) for f in footprints[warm:]])
    if len(rest) < 3:
        return None
    third = max(1, len(rest) // 3)
    rss, descriptors, threads = np.median(rest[-third:], axis=0) - np.median(rest[:third], axis=0)
    return Growth(round(float(rss), 2), float(descriptors), float(threads), len(rest))
