"""What the mock's optics see: a made-up groove, a recorded sweep, or the mock world.

A recorded sweep is an .npz with ``profile_x_m`` and ``profile_z_m`` (K, M), NaN where nothing was measured; other
arrays in it (poses, times, points) are for other readers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from perception.geometry import Array


class Source(Protocol):
    """Where a profile's points come from."""

    def line(self, number: int, time_s: float) -> Array | None:
        """Points (M, 2), x and z in metres, NaN where nothing is measured; None while that time is not known yet."""

    def begin_sweep(self) -> None:
        """The laser was switched on."""


class GrooveSource:
    """A flat panel 0.4 m away with a groove that wanders with the profile's number: a picture without any world."""

    def __init__(self, points: int = 1000) -> None:
        self._x = np.linspace(-0.08, 0.08, points)

    def begin_sweep(self) -> None:
        """Nothing changes."""

    def line(self, number: int, time_s: float) -> Array:
        """The same points for the same number."""
        centre = 0.05 * np.sin(0.05 * number)
        z = 0.4 + 0.02 * np.exp(-(((self._x - centre) / 0.01) ** 2))
        z[np.abs(self._x) > 0.078] = np.nan
        return np.stack([self._x, z], axis=1)


class RecordedSource:
    """The profiles of a recorded sweep in order, again from the first after each laser-on and after the last."""

    def __init__(self, path: Path) -> None:
        with np.load(path, allow_pickle=False) as archive:
            x, z = archive["profile_x_m"], archive["profile_z_m"]
        if x.ndim != 2 or x.shape != z.shape or not len(x):
            raise ValueError(f"{path} holds no recorded profiles: profile_x_m and profile_z_m are (K, M)")
        self._lines = np.stack([x, z], axis=2).astype(np.float64)
        self._first: int | None = None

    def begin_sweep(self) -> None:
        """Start over with the next profile."""
        self._first = None

    def line(self, number: int, time_s: float) -> Array:
        """Profile ``number`` counted from the sweep's first."""
        if self._first is None:
            self._first = number
        chosen: Array = self._lines[(number - self._first) % len(self._lines)]
        return chosen
