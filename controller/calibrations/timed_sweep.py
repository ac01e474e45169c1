"""A sweep for a calibration: its profiles bear the time of their measurement."""

from __future__ import annotations

from dataclasses import replace

from controller.cell import Cell
from controller.config import SiteConfig
from controller.planning import Viewpoint
from controller.scan_session import go_to_start, sweep_over
from controller.states import State
from controller.sweep import scan_of
from controller.sweeping import ProgressReport, taken_moving
from perception.scan import Scan


def timed_sweep(cell: Cell, config: SiteConfig, view: Viewpoint, report: ProgressReport) -> Scan:
    """Go to its start and make it: speeds and time offset are taken from the times. Raises MissionFault, SweepError."""
    if config.scanner.sync == "stop_and_go":
        return sweep_over(cell, config, (view,), report)
    go_to_start(cell, config, view)
    cell.enter(State.SCANNING, config.deadlines.scanning_s)
    try:
        sweep = taken_moving(cell, config, (view,), report)
    finally:
        cell.enter(State.READY, None)
    scan = scan_of(sweep, config.scanner.T_flange_scanner.pose)
    profiles = [
        replace(profile, time_s=float(time_s)) for profile, time_s in zip(scan.profiles, sweep.times_s, strict=True)
    ]
    return replace(scan, profiles=tuple(profiles))
