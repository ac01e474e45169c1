"""Sweeps outside a mission: to record a scan, and to measure the scanner's time offset. The gate and the tick are live.

A sweep moves the arm in front of a vehicle, so a plug that the proximity contact does not report absent forbids it. One
that is half in is not noticed here: no axis of an insertion is recalled.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller.assembly import assemble
from controller.cell import Cell
from controller.commands import MoveJoints
from controller.config import SiteConfig, as_yaml
from controller.faults import FaultCode, MissionFault
from controller.looking import MOST_SPOILED, plan_view
from controller.planning import Viewpoint
from controller.recording.recorder import Recorder
from controller.states import State
from controller.sweep import SweepError, clock_facts
from controller.sweeping import HISTORY_S, ProgressReport, run_sweep
from drivers.base import ArmState, LinkHealth, MonotonicClock, Proximity, RobotMode
from perception.errors import PortdockError
from perception.scan import Cloud, Scan

log = logging.getLogger(__name__)

STATUS_S = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScan:
    """What a recorded sweep gave."""

    path: Path
    profiles: int
    cloud: Cloud
    scanner: LinkHealth


def record_scan(
    config: SiteConfig, target: Path, report: ProgressReport, *, pace: float = 1.0, heartbeat_mode: int = 3
) -> RecordedScan:
    """Sweep once from the first viewpoint and leave raw bytes, arm poses, clock data and the cloud in ``target``.

    :raises MissionFault: the arm cannot, or may not, make the sweep
    :raises SweepError: the sweep cannot be used; the raw bytes are recorded all the same
    :raises LinkOpenError: a device cannot be opened; nothing is left then
    """
    recorder = Recorder(target, MonotonicClock())
    try:
        with ExitStack() as closing:
            closing.callback(recorder.close)
            try:
                cell = assemble(config, recorder, closing, pace=pace, heartbeat_mode=heartbeat_mode).cell
            except PortdockError:
                closing.callback(target.unlink, missing_ok=True)
                raise
            recorder.attach("config.yaml", as_yaml(config).encode(), "application/yaml")
            recorder.transform("flange", "scanner", config.scanner.T_flange_scanner.pose)
            began_s = cell.wall.now_s()
            try:
                scan = _swept(cell, config, report)
            finally:
                for name, link in cell.healths():
                    recorder.link(name, link)
            cloud = scan.to_cloud()
            recorder.scan(cloud)
            states = cell.arm.history(began_s - HISTORY_S["timestamp"])
            recorder.metadata("clocks", dict(clock_facts(scan.profiles, states, pace)))
            health = cell.scanner.health()
    finally:
        recorder.close()
    return RecordedScan(target, len(scan.profiles), cloud, health)


def _swept(cell: Cell, config: SiteConfig, report: ProgressReport) -> Scan:
    """A sweep that can be used, of a few. Raises what the last one raised."""
    passes = plan_view(config, 0)
    for _ in range(MOST_SPOILED):
        try:
            return sweep_over(cell, config, passes, report)
        except SweepError as error:
            log.warning("this sweep cannot be used, it is made again: %s", error.cause)
    return sweep_over(cell, config, passes, report)


def sweep_over(cell: Cell, config: SiteConfig, passes: Sequence[Viewpoint], report: ProgressReport) -> Scan:
    """To the sweep's start, then the sweep. Raises MissionFault, SweepError."""
    go_to_start(cell, config, passes[0])
    cell.enter(State.SCANNING, config.deadlines.scanning_s)
    try:
        return run_sweep(cell, config, passes, report)
    finally:
        cell.enter(State.READY, None)


def go_to_start(cell: Cell, config: SiteConfig, view: Viewpoint) -> None:
    """Joint motion to where a sweep begins. Raises MissionFault while a plug may be in the port."""
    patience_s = config.deadlines.self_check_s
    cell.enter(State.SELF_CHECK, patience_s)
    cell.supervisor.wait(lambda: cell.arm_state() is not None and cell.charger_status() is not None, STATUS_S)
    if not cell.charger_says(lambda status: status.proximity is Proximity.ABSENT):
        raise MissionFault(FaultCode.PLUG_INSERTED_AT_START, "a plug may be in the port: the arm is not moved to scan")
    if not cell.supervisor.wait(lambda: cell.charger_says(lambda status: not status.forbids_motion), patience_s):
        raise MissionFault(FaultCode.CHARGER_FAULT, "the charger inhibits motion although it gets our heartbeat")
    if not cell.supervisor.wait(lambda: _runs(cell.arm_state()), patience_s):
        raise MissionFault(FaultCode.ARM_NOT_READY, "the arm is not powered and running")
    cell.enter(State.STAGING, config.deadlines.staging_s)
    speed, acceleration = np.deg2rad([config.motion.joint_speed_deg_s, config.motion.joint_acceleration_deg_s2])
    cell.travel(MoveJoints(view.T_base_tcp_start, float(speed), float(acceleration)), config.deadlines.staging_s)
    cell.settle(0.001, config.deadlines.staging_s)


def _runs(state: ArmState | None) -> bool:
    return state is not None and state.mode is RobotMode.RUNNING and state.program_running
