"""Teach by plugging on the live cell: dock by force, note where the plug is while it is locked, back off, look thrice.

The docking is a mission like any other, with its gate, interlocks and retries; it ends with the plug out again. A plug
that cannot be docked with untaught is to be brought into the capture range by a better calibration first.
"""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from controller.assembly import Assembly, assemble
from controller.cell import Cell
from controller.config import SiteConfig
from controller.faults import Outcome
from controller.insertion import Insertion
from controller.looking import plan_view
from controller.mission import Mission
from controller.planning import DockPlan
from controller.scan_session import sweep_over
from controller.sweep import SweepError
from controller.sweeping import ProgressReport
from controller.task import Goal, Progress
from controller.unrecorded import Unrecorded
from perception.calibration.errors import CalibrationError
from perception.calibration.teaching import Taught, teach
from perception.estimate import PortEstimate, Prior
from perception.geometry import Pose
from perception.scan import Cloud

log = logging.getLogger(__name__)

VIEWS = (0, 1, 0)
"""Viewpoints of the scans after the dock: two different ones, and the first once more."""
TRIES = 3
"""Scans from one viewpoint, until one is accepted."""


class TeachError(CalibrationError):
    """The plug was not mated, or the port is not seen where it was docked at. Nothing is stored."""

    code = "teach"


class _Note:
    """A mission's watcher that only passes its progress on."""

    def __init__(self, report: ProgressReport) -> None:
        self.progress = report

    def began(self, goal: Goal) -> None: ...
    def transition(self, source: str, event: str, target: str, time_s: float) -> None: ...
    def scan(self, cloud: Cloud) -> None: ...
    def estimate(self, estimate: PortEstimate) -> None: ...
    def insertion(self, insertion: Insertion) -> None: ...
    def ended(self, outcome: Outcome, job: Progress) -> None: ...


@dataclass(frozen=True, slots=True, eq=False)
class Mated:
    """A dock that ended with the plug locked in, and out again."""

    T_base_tcp: Pose
    """At rest, while the charger said locked."""
    plan: DockPlan
    """That led there: where the mission located the port."""


def teach_port(
    config: SiteConfig, folder: Path, report: ProgressReport, *, pace: float = 1.0, heartbeat_mode: int = 3
) -> Taught:
    """The mated plug in the port's frame as this cell sees it. Raises CalibrationError, MissionFault, LinkOpenError.

    :param folder: for what must survive the process while the plug is in
    """
    with ExitStack() as closing:
        live = assemble(config, Unrecorded(), closing, pace=pace, heartbeat_mode=heartbeat_mode)
        mated = mate(live, config, folder, report)
        return teach([located(live.cell, config, number, report) for number in VIEWS], mated.T_base_tcp)


def mate(live: Assembly, config: SiteConfig, folder: Path, report: ProgressReport) -> Mated:
    """Dock by force, and undock at once. Raises TeachError if the plug was not mated."""
    brief = config.model_copy(update={"mission": config.mission.model_copy(update={"charge_s": 0.0})})
    mission = Mission(live.cell, brief, live.T_port_tcp_mated, _Note(report), folder)
    outcome = mission.run(Goal.CYCLE)
    T_base_tcp, plan = mission.now.T_base_tcp_mated, mission.now.plan
    if outcome.kind != "charged" or T_base_tcp is None or plan is None:
        why = "" if outcome.fault is None else f": {outcome.fault}"
        raise TeachError(f"the plug was not mated ({outcome.kind}{why})", remedy=_remedy(outcome))
    return Mated(T_base_tcp, plan)


def _remedy(outcome: Outcome) -> str:
    first = "" if outcome.fault is None else f"{outcome.fault.remedy} "
    return first + "A plug that misses its port needs `portdock calibrate hand-eye` first."


def located(cell: Cell, config: SiteConfig, number: int, report: ProgressReport) -> Pose:
    """T_base_port from one scan alone: of a few tries the first that is accepted. Raises TeachError without any."""
    reasons = ""
    for _ in range(TRIES):
        try:
            cloud = sweep_over(cell, config, plan_view(config, number), report).to_cloud()
        except SweepError as error:
            reasons = error.cause
            log.warning("this sweep cannot be used, it is made again: %s", error.cause)
            continue
        future = cell.locator.submit([cloud], Prior(config.port.T_base_port.pose))
        cell.supervisor.wait(future.done)
        estimate = future.result()
        if estimate.accepted:
            return estimate.T_ref_port
        reasons = "; ".join(estimate.reasons)
        log.warning("this scan is not accepted, it is made again: %s", reasons)
    raise TeachError(
        f"the port just docked at is not accepted from viewpoint {number + 1}: {reasons}",
        remedy="Check port.model, clean the scanner's window, keep the sun off the port; teach again.",
    )
