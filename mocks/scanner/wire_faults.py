"""What serial lines do to bytes: lose, double, flip, fall silent; and what a wrong baud rate makes of all of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, slots=True)
class FaultRates:
    """Probabilities for each byte, and one silence."""

    lost: float = 0.0
    doubled: float = 0.0
    flipped: float = 0.0
    stall_at_s: float | None = None
    """Emulated time from which nothing arrives any more."""
    stall_s: float = float("inf")
    """How long the silence lasts; what was sent meanwhile is gone."""


@dataclass
class WireFaults:
    """Applies ``FaultRates`` to what leaves the device, and counts what it did."""

    rates: FaultRates
    rng: np.random.Generator
    counts: dict[str, int] = field(default_factory=lambda: {"lost": 0, "doubled": 0, "flipped": 0, "stalled": 0})

    def spoil(self, data: bytes, now_s: float, wrong_baud: bool) -> bytes:
        """The bytes that arrive."""
        rates = self.rates
        if rates.stall_at_s is not None and 0 <= now_s - rates.stall_at_s < rates.stall_s:
            self.counts["stalled"] += len(data)
            return b""
        if wrong_baud:  # sampled at wrong times: as many bytes, none of them right
            return self.rng.integers(0, 256, len(data), np.uint8).tobytes()
        if rates.lost == rates.doubled == rates.flipped == 0.0:
            return data
        raw = np.frombuffer(data, np.uint8)
        copies = np.ones(len(raw), np.int64)
        draw = self.rng.random((3, len(raw)))
        copies[draw[0] < rates.lost] = 0
        copies[draw[1] < rates.doubled] = 2
        flipped = draw[2] < rates.flipped
        bits = np.where(flipped, np.uint8(1) << self.rng.integers(0, 8, len(raw), np.uint8), np.uint8(0))
        self.counts["lost"] += int((copies == 0).sum())
        self.counts["doubled"] += int((copies == 2).sum())
        self.counts["flipped"] += int(flipped.sum())
        return np.repeat(raw ^ bits, copies).astype(np.uint8).tobytes()
