"""What the mock's optics see: a made-up groove, a recorded sweep, or the mock world.

A recorded sweep is an .npz with ``profile_x_m`` and ``profile_z_m`` (K, M), NaN where nothing was measured; other
arrays in it (poses, times, points) are for other readers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:  # SciPy behind it would double the time that a mock takes to come up
    from perception.geometry import Array


class Source(Protocol):
    """Where a profile's points come from."""

    def lines(self, first: int, times_s: Sequence[float]) -> list[Array]:
        """Profiles ``first``, ``first + 1``, ... exposed at ``times_s``, as many as are known yet, from the first.

        Each is points (M, 2), x and z in metres, NaN where nothing is measured.
        """

    def begin_sweep(self) -> None:
        """The laser was switched on."""


class GrooveSource:
    """A flat panel with a groove that wanders with the profile's number: a picture without any world."""

    def __init__(self, points: int = 1000, half_width_m: float = 0.08, distance_m: float = 0.4) -> None:
        self._x = np.linspace(-half_width_m, half_width_m, points)
        self._distance_m = distance_m

    def begin_sweep(self) -> None:
        """Nothing changes."""

    def lines(self, first: int, times_s: Sequence[float]) -> list[Array]:
        """The same points for the same number."""
        return [self._line(first + k) for k in range(len(times_s))]

    def _line(self, number: int) -> Array:
        half = self._x[-1]
        centre = 0.625 * half * np.sin(0.05 * number)
        z = self._distance_m + 0.25 * half * np.exp(-(((self._x - centre) / (0.125 * half)) ** 2))
        z[np.abs(self._x) > 0.975 * half] = np.nan
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

    def lines(self, first: int, times_s: Sequence[float]) -> list[Array]:
        """Profiles counted from the sweep's first."""
        if self._first is None:
            self._first = first
        return [self._lines[(first + k - self._first) % len(self._lines)] for k in range(len(times_s))]
