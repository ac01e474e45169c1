"""What a turning range finder sees: a room that it makes up, or the mock world from where the arm truly was.

Time of flight, so no camera and no shadow; the range is of a patch as wide as the beam, and surfaces of other colour
read nearer or farther, all points of one alike. Not simulated: motion within a turn, multiple echoes in one beam, what
distance and temperature do to ranges.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mocks.scanner.emulated_clock import EmulatedClock

Ints = NDArray[np.int64]
Scan = tuple[Ints, Ints]
"""Range in mm and intensity of each step."""


class View(Protocol):
    """Where a turning range finder's ranges come from."""

    def scan(self, number: int, time_s: float) -> Scan | None:
        """The scan with this number, taken at this time; None while it is not known what is seen then."""


class RoomView:
    """A wall all around with a dent that wanders; the first ten steps give an error code."""

    def __init__(self, steps: Ints, front_step: int) -> None:
        self._steps = steps
        self._front_step = front_step

    def scan(self, number: int, time_s: float) -> Scan:
        """Known at any time."""
        dent = self._front_step + 100 * np.sin(0.3 * number)
        ranges = np.round(1500 + 400 * np.exp(-(((self._steps - dent) / 20) ** 2)) + 0.5 * self._steps).astype(np.int64)
        ranges[:10] = 7  # below DMIN: an error code
        return ranges, 1000 + self._steps


NO_ECHO_MM = 0
"""An error code: below every device's least range."""


class WorldView:
    """The mock world, with ranges as good as a time-of-flight range finder's."""

    def __init__(
        self,
        folder: Path,
        angles: NDArray[np.float64],
        rng: np.random.Generator,
        *,
        coarse: bool,
        noise_m: float,
        systematic_m: float,
    ) -> None:
        """``angles``: of the steps, rad, to the right of the front; ``coarse``: on the mount of the second scanner."""
        from mocks.scanner.world_source import VehicleSeen  # the ray-caster takes seconds to import
        from perception.evaluation.scene import KINDS

        self._seen = VehicleSeen(folder, coarse=coarse)
        self._angles = angles
        self._rng = rng
        self._noise_m = noise_m
        by_kind = np.random.default_rng([self._seen.spec.seed, 3]).normal(0.0, systematic_m, len(KINDS))
        self._bias_m: Callable[[Ints], NDArray[np.float64]] = lambda kinds: by_kind[kinds]

    @property
    def clock(self) -> EmulatedClock:
        """The world's time."""
        return self._seen.clock

    def scan(self, number: int, time_s: float) -> Scan | None:
        """Once the arm mock has published its pose for that time."""
        return self.at(self._angles, time_s)

    def at(self, angles_rad: NDArray[np.float64], time_s: float) -> Scan | None:
        """The same for any angles (N,) to the right of the front."""
        from perception.evaluation.range_finder import ranges_from

        T_port_scanner = self._seen.T_port_scanner(time_s)
        if T_port_scanner is None:
            return None
        true_m, kinds = ranges_from(self._seen.scene, T_port_scanner, angles_rad, self._rng)
        measured_m = true_m + self._bias_m(kinds) + self._rng.normal(0.0, self._noise_m, len(true_m))
        hit = np.isfinite(true_m) & (measured_m > 0.0)
        millimetres = np.where(hit, np.round(np.where(hit, measured_m, 0.0) * 1e3), NO_ECHO_MM).astype(np.int64)
        return millimetres, np.where(hit, 1000, 0).astype(np.int64)
