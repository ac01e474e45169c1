"""What every method under evaluation hands back, and the one problem that all of them are given. Millimetres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from perception.geometry import Array, Pose
from perception.published.kdtree_numpy import Mask


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """One scan to register. Holds nothing of the truth."""

    test: Array
    """(N, 3) mm."""
    rounds: int
    """Registrations that a method may take; each is warm-started by the one before."""
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Iterate:
    """What a method would answer after one registration."""

    T_target_test: Pose
    kept: Mask | None
    """(N,) the cleaned scan, None where the method cleans nothing."""
    elapsed_s: float
    """Processor time of this registration alone; the first holds the preparation of the scan too."""


Outcome = tuple[Iterate, ...]
Solver = Callable[[Problem], Outcome]
"""A method with its target prepared: that is done once for all scans and does not count."""


class Stopwatch:
    """Splits time into laps."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._last = clock, clock()

    def lap(self) -> float:
        """Seconds since the last lap or the start."""
        now = self._clock()
        elapsed, self._last = now - self._last, now
        return elapsed


def generator(problem: Problem) -> np.random.Generator:
    """The randomness of one solver on one problem: the same whatever else has run."""
    return np.random.default_rng(problem.seed)
