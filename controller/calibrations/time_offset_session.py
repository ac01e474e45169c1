"""The scanner's constant time offset, measured on the cell: one target swept forth and back, several times."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from controller.assembly import assemble
from controller.cell import Cell
from controller.config import SiteConfig
from controller.looking import MOST_SPOILED, plan_view
from controller.planning import Viewpoint
from controller.scan_session import go_to_start
from controller.states import State
from controller.sweep import SweepError
from controller.sweeping import ProgressReport, taken_moving
from controller.unrecorded import Unrecorded
from perception.time_offset import TimedSweep, TimeOffset, estimate_time_offset

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TimeOffsetFound:
    """What ``scanner.latency_ms`` should be."""

    latency_ms: float
    sigma_ms: float
    """1 sigma: of the rounds' spread, or of the residuals where that is larger."""
    offsets_ms: tuple[float, ...]
    """What each round found to add to the profiles' times."""
    residual_mm: float
    """Between the two clouds once it is applied, rms."""

    def to_json(self) -> dict[str, object]:
        """As ``--json`` prints it."""
        return {
            "latency_ms": round(self.latency_ms, 4),
            "sigma_ms": round(self.sigma_ms, 4),
            "offsets_ms": [round(offset_ms, 4) for offset_ms in self.offsets_ms],
            "residual_mm": round(self.residual_mm, 4),
        }


def measure_time_offset(
    config: SiteConfig, rounds: int, report: ProgressReport, *, pace: float = 1.0, heartbeat_mode: int = 3
) -> TimeOffsetFound:
    """Sweep the middle pass forth and back ``rounds`` times. Raises MissionFault, SweepError, TimeOffsetError."""
    passes = plan_view(config, 0)
    forth = passes[len(passes) // 2]
    back = Viewpoint(forth.T_base_tcp_end, forth.T_base_tcp_start)
    with ExitStack() as closing:
        cell = assemble(config, Unrecorded(), closing, pace=pace, heartbeat_mode=heartbeat_mode).cell
        go_to_start(cell, config, forth)
        cell.enter(State.SCANNING, config.deadlines.scanning_s * 2 * rounds)
        found = [_round(cell, config, forth, back, report) for _ in range(rounds)]
        cell.enter(State.READY, None)
    offsets_s = np.array([one.offset_s for one in found])
    spread_s = float(offsets_s.std(ddof=1) / np.sqrt(rounds)) if rounds > 1 else 0.0
    return TimeOffsetFound(
        latency_ms=config.scanner.latency_ms - float(offsets_s.mean()) * 1e3,
        sigma_ms=max(spread_s, found[0].sigma_s) * 1e3,
        offsets_ms=tuple(float(offset_s) * 1e3 for offset_s in offsets_s),
        residual_mm=max(one.residual_m for one in found) * 1e3,
    )


def _round(cell: Cell, config: SiteConfig, forth: Viewpoint, back: Viewpoint, report: ProgressReport) -> TimeOffset:
    """Forth and back; what cannot be used is swept again, each time in the direction that the arm stands for."""
    sweeps: dict[bool, TimedSweep] = {}
    for number in range(2 * (MOST_SPOILED + 1)):
        there = number % 2 == 0
        try:
            sweeps[there] = _swept(cell, config, forth if there else back, report)
        except SweepError as error:
            log.warning("this sweep cannot be used, it is made again: %s", error.cause)
        if not there and len(sweeps) == 2:
            return estimate_time_offset(sweeps[True], sweeps[False])
    raise SweepError("no sweep could be used")


def _swept(cell: Cell, config: SiteConfig, view: Viewpoint, report: ProgressReport) -> TimedSweep:
    """One sweep; times in the device's seconds."""
    sweep = taken_moving(cell, config, (view,), report)
    scale = 1.0 if config.scanner.sync in ("shared_clock", "trigger") else cell.time_scale
    T_flange_scanner = config.scanner.T_flange_scanner.pose
    return TimedSweep(sweep.profiles, sweep.times_s * scale, sweep.track_s * scale, sweep.track, T_flange_scanner)
