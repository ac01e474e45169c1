"""Does docking still end where it used to? An EWMA control chart of six axes for each port type.

Each successful dock tells where the plug came to rest against where the estimate said. While nothing changes these
offsets scatter about a constant; a bumped scanner, a worn plug or a port taught badly moves the constant. The chart
(Roberts 1959; Lucas and Saccucci 1990) sees a shift of a few standard deviations within a few docks. Whatever moves
moves several axes at once, so they are judged together (Lowry, Woodall, Champ and Rigdon 1992).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array

AXES = ("x", "y", "z", "tilt about x", "tilt about y", "roll")
Cause = Literal["hand-eye or tool", "teaching of this port"]


@dataclass(frozen=True, slots=True, eq=False)
class Dock:
    """One successful dock."""

    port: str
    """Port type."""
    offset: Array
    """(6,) plug at rest minus expected, in the port frame: metres, then rotation vector in radians."""


@dataclass(frozen=True, slots=True)
class ChartSettings:
    """How the chart judges."""

    memory: float = 0.3
    """Weight of the newest dock."""
    limit: float = 6.2
    """Standard deviations that all axes together may be off: hardly a false alarm in 500 docks."""
    baseline: int = 20
    """Docks that make the standard at first; until there are so many, nothing is judged."""
    complete: int = 100
    """Docks that make it in the end: twenty alone tell their own scatter too badly. Growth ends with an alarm."""
    apart: int = 10
    """The newest docks are not in the standard that they are held against."""
    least_sigma_m: float = 0.00003
    least_sigma_rad: float = 0.0003
    """The scatter counts as at least this: a few docks may happen to agree."""


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """The chart of one port type: n judged docks, six axes."""

    average: Array
    """(n, 6) exponentially weighted, from the first standard's mean on."""
    centre: Array
    """(n, 6) mean of the standard that each was held against."""
    sigma: Array
    """(n, 6) standard deviation of average minus centre while nothing changes."""
    limit: float
    """Of ``distance``."""
    standard: int
    """Docks in the newest standard."""

    @property
    def shift(self) -> Array:
        """(n, 6) of the average against the standard."""
        return self.average - self.centre

    @property
    def distance(self) -> Array:
        """(n,) standard deviations that all axes together are off."""
        return np.asarray(np.linalg.norm(self.shift / self.sigma, axis=1))

    @property
    def alarms(self) -> NDArray[np.bool_]:
        """(n,) True where the average left its bounds."""
        return self.distance > self.limit

    @property
    def shifted(self) -> NDArray[np.bool_]:
        """(n, 6) which axes make an alarm: those off by at least half as many standard deviations as the worst."""
        off = np.abs(self.shift / self.sigma)
        return np.asarray(self.alarms[:, None] & (off >= 0.5 * off.max(axis=1, keepdims=True)))


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """What a chart warns of."""

    port: str
    docks_ago: int
    """When the average left its bounds, counted from the newest dock."""
    axes: tuple[str, ...]
    shift: Array
    """(6,) of the newest average against the standard."""
    sigma: Array
    """(6,) of the shift, 1 sigma."""
    cause: Cause


def chart(docks: Sequence[Dock], settings: ChartSettings | None = None) -> Chart | None:
    """The chart of docks at one port type, oldest first; None before the first standard is complete."""
    s = settings or ChartSettings()
    if len(docks) <= s.baseline:
        return None
    offsets = np.stack([dock.offset for dock in docks])
    least = np.array([s.least_sigma_m] * 3 + [s.least_sigma_rad] * 3)
    last, size, frozen = offsets[: s.baseline].mean(axis=0), s.baseline, False
    rows = list[tuple[Array, Array, Array]]()
    for n in range(s.baseline, len(offsets)):  # each average needs the one before
        if not frozen:
            size = min(max(s.baseline, n - s.apart), s.complete)
        standard = offsets[:size]
        last = s.memory * offsets[n] + (1.0 - s.memory) * last
        share = s.memory / (2.0 - s.memory) * (1.0 - (1.0 - s.memory) ** (2 * (n - s.baseline + 1)))
        sigma = np.maximum(standard.std(axis=0, ddof=1), least) * np.sqrt(share + 1.0 / size)
        rows.append((last, standard.mean(axis=0), sigma))
        frozen = frozen or float(np.linalg.norm((last - rows[-1][1]) / sigma)) > s.limit
    average, centre, sigma = (np.stack(column) for column in zip(*rows, strict=True))
    return Chart(average, centre, sigma, s.limit, size)


def warnings(docks: Sequence[Dock], settings: ChartSettings | None = None) -> tuple[Drift, ...]:
    """What to warn of after the newest dock: port types whose average is out of bounds now, with the likely cause."""
    s = settings or ChartSettings()
    charts = {port: chart([dock for dock in docks if dock.port == port], s) for port in {dock.port for dock in docks}}
    judged = {port: found for port, found in charts.items() if found is not None}
    out = {port: found for port, found in judged.items() if found.alarms[-1]}
    cause: Cause = _cause(judged, out)
    return tuple(
        Drift(
            port,
            _docks_ago(found),
            tuple(axis for axis, alarmed in zip(AXES, found.shifted[-1], strict=True) if alarmed),
            found.shift[-1],
            found.sigma[-1],
            cause,
        )
        for port, found in sorted(out.items())
    )


def _docks_ago(found: Chart) -> int:
    """Length of the run of alarms that the newest dock ends, minus one."""
    quiet = np.flatnonzero(~found.alarms)
    return int(len(found.alarms) - 2 - (quiet[-1] if len(quiet) else -1))


def _cause(judged: dict[str, Chart], out: dict[str, Chart]) -> Cause:
    """All ports alike: what they have in common. One of several: its teaching. A single port says nothing of others."""
    return "teaching of this port" if len(out) < len(judged) else "hand-eye or tool"
