"""Does docking still end where it used to? An EWMA control chart for each axis and port type.

Each successful dock tells where the plug came to rest against where the estimate said. While nothing changes these
offsets scatter about a constant; a bumped scanner, a worn plug or a port taught badly moves the constant. The chart
(Roberts 1959; Lucas and Saccucci 1990) sees a shift of a few standard deviations within a few docks.
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
    limit: float = 5.0
    """Standard deviations of the average that it may be off: no false alarm in 500 docks of six axes."""
    baseline: int = 20
    """Docks that make the standard; until there are so many, nothing is judged."""
    least_sigma_m: float = 0.00003
    least_sigma_rad: float = 0.0003
    """The scatter counts as at least this: a few docks may happen to agree."""


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """The chart of one port type: n docks, six axes."""

    average: Array
    """(n, 6) exponentially weighted, from the standard's mean on."""
    centre: Array
    """(6,) mean of the standard."""
    bound: Array
    """(n, 6) how far the average may be from the centre."""

    @property
    def alarms(self) -> NDArray[np.bool_]:
        """(n, 6) True where the average left its bounds."""
        return np.abs(self.average - self.centre) > self.bound


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
    """The chart of docks at one port type, oldest first; None before the standard is complete."""
    s = settings or ChartSettings()
    if len(docks) <= s.baseline:
        return None
    offsets = np.stack([dock.offset for dock in docks])
    standard = offsets[: s.baseline]
    centre = standard.mean(axis=0)
    least = np.array([s.least_sigma_m] * 3 + [s.least_sigma_rad] * 3)
    sigma = np.maximum(standard.std(axis=0, ddof=1), least)
    judged = offsets[s.baseline :]
    average, last = np.empty_like(judged), centre
    for n, offset in enumerate(judged):  # each average needs the one before
        last = average[n] = s.memory * offset + (1.0 - s.memory) * last
    age = np.arange(1, len(judged) + 1)[:, None]
    share = s.memory / (2.0 - s.memory) * (1.0 - (1.0 - s.memory) ** (2 * age))
    return Chart(average, centre, s.limit * sigma * np.sqrt(share + 1.0 / s.baseline))


def warnings(docks: Sequence[Dock], settings: ChartSettings | None = None) -> tuple[Drift, ...]:
    """What to warn of after the newest dock: port types whose average is out of bounds now, with the likely cause."""
    s = settings or ChartSettings()
    charts = {port: chart([dock for dock in docks if dock.port == port], s) for port in {dock.port for dock in docks}}
    judged = {port: found for port, found in charts.items() if found is not None}
    out = {port: found for port, found in judged.items() if found.alarms[-1].any()}
    cause: Cause = _cause(judged, out)
    return tuple(
        Drift(
            port,
            _docks_ago(found),
            tuple(axis for axis, alarmed in zip(AXES, found.alarms[-1], strict=True) if alarmed),
            found.average[-1] - found.centre,
            found.bound[-1] / s.limit,
            cause,
        )
        for port, found in sorted(out.items())
    )


def _docks_ago(found: Chart) -> int:
    """Length of the run of alarms that the newest dock ends, minus one."""
    quiet = np.flatnonzero(~found.alarms.any(axis=1))
    return int(len(found.alarms) - 2 - (quiet[-1] if len(quiet) else -1))


def _cause(judged: dict[str, Chart], out: dict[str, Chart]) -> Cause:
    """All ports alike: what they have in common. One of several: its teaching. A single port says nothing of others."""
    return "teaching of this port" if len(out) < len(judged) else "hand-eye or tool"
