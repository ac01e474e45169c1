"""The plug's frame at the flange on the live cell: dock by force, back off, look from several sides; more than once."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from controller.assembly import Assembly, assemble
from controller.calibrations.teach_session import located, mate
from controller.config import SiteConfig
from controller.looking import plan_view
from controller.sweeping import ProgressReport
from controller.unrecorded import Unrecorded
from perception.calibration.mated_tool import Known, Look, MatedDock, MatedTool, tool_by_mating
from perception.geometry import Pose


def calibrate_tcp(
    config: SiteConfig,
    known: Known,
    docks: int,
    folder: Path,
    report: ProgressReport,
    *,
    pace: float = 1.0,
    heartbeat_mode: int = 3,
) -> MatedTool:
    """``T_flange_tcp`` by mating. Raises CalibrationError, MissionFault, LinkOpenError; nothing is stored.

    :param folder: for what must survive the process while the plug is in
    """
    with ExitStack() as closing:
        live = assemble(config, Unrecorded(), closing, pace=pace, heartbeat_mode=heartbeat_mode)
        return tool_by_mating([_dock(live, config, folder, report) for _ in range(docks)], known)


def _dock(live: Assembly, config: SiteConfig, folder: Path, report: ProgressReport) -> MatedDock:
    mated = mate(live, config, folder, report)
    T_tcp_flange = config.arm.T_flange_tcp.pose.inverse()
    views = range(len(config.scan.viewpoints))
    looks = tuple(Look(_middle(config, k), located(live.cell, config, k, report)) for k in views)
    return MatedDock(mated.T_base_tcp @ T_tcp_flange, mated.plan.T_base_port, looks)


def _middle(config: SiteConfig, number: int) -> Pose:
    """T_base_flange halfway of a viewpoint's sweep."""
    passes = plan_view(config, number)
    first, last = passes[0].T_base_tcp_start, passes[-1].T_base_tcp_end
    middle = Pose(first.rotation, 0.5 * (first.translation + last.translation))
    return middle @ config.arm.T_flange_tcp.pose.inverse()
