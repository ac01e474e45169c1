"""Sweep and locate: from a viewpoint to a port estimate, over the scans of one mission."""

from __future__ import annotations

import logging

import numpy as np

from controller.cell import Cell
from controller.config import SiteConfig
from controller.faults import FaultCode, MissionFault
from controller.passes import plan_passes
from controller.planning import Viewpoint
from controller.port_files import load_port
from controller.rough_look import CoarseStage, NoRoughPlaceError, RoughLook
from controller.scanner_facts import scanner_facts
from controller.sweep import SweepError
from controller.sweeping import ProgressReport, run_sweep
from perception.errors import InputError, PortdockError
from perception.estimate import PortEstimate, Prior
from perception.scan import Cloud

log = logging.getLogger(__name__)

MOST_SPOILED = 3
"""So many sweeps that cannot be used (profiles lost, times uncertain) are repeated from the same viewpoint."""


class Looking:
    """The scans of one mission and what perception makes of them."""

    def __init__(self, cell: Cell, config: SiteConfig, coarse: CoarseStage | None = None) -> None:
        """``coarse``: what the site's coarse stage works with, where it has one."""
        self._cell = cell
        self._config = config
        self._rough = RoughLook(cell, config, config.coarse, coarse) if config.coarse and coarse else None
        """The coarse stage, until it has aimed the precise one."""
        self._clouds: list[Cloud] = []
        self._spoiled = 0
        self.scans_made = 0
        self.problem = ""
        """Why the last scan could not be used; empty if it could."""

    @property
    def cloud(self) -> Cloud | None:
        """The newest scan in the base frame."""
        return self._clouds[-1] if self._clouds else None

    def may_look_again(self, attempt: int) -> bool:
        """Whether another scan is due before giving up: one a viewpoint, and one more for each further attempt."""
        if self._rough is not None and self._spoiled > MOST_SPOILED:
            return False
        return self.scans_made < len(self._config.scan.viewpoints) + attempt - 1

    def forget_scans(self) -> None:
        """The last rung of the ladder trusts nothing that was seen before."""
        self._clouds.clear()

    def passes(self) -> tuple[Viewpoint, ...]:
        """The next sweep: the coarse one first, where there is one; then each scan from another viewpoint."""
        if self._rough is not None:
            return self._rough.passes()
        return plan_view(self._config, self.scans_made)

    def viewpoint(self) -> Viewpoint:
        """The first pass of the next sweep, for staging."""
        return self.passes()[0]

    def sweep(self, report: ProgressReport) -> None:
        """One sweep from the next viewpoint. What it gives is kept, or why it cannot be used."""
        if self._rough is not None:
            self._sweep_roughly(self._rough, report)
            return
        try:
            self._clouds.append(run_sweep(self._cell, self._config, self.passes(), report).to_cloud())
            self.problem = ""
        except (SweepError, InputError) as error:
            self.problem = error.cause
            log.warning("this scan cannot be used: %s", error)
        if self.problem and self._spoiled < MOST_SPOILED:
            self._spoiled += 1  # the viewpoint is not to blame: the same one again
        else:
            self.scans_made += 1

    def _sweep_roughly(self, rough: RoughLook, report: ProgressReport) -> None:
        try:
            rough.sweep(report)
            self.problem = ""
        except (SweepError, InputError) as error:
            self.problem = error.cause
            self._spoiled += 1
            log.warning("this coarse scan cannot be used: %s", error)

    def _aim(self, rough: RoughLook) -> None:
        """From here on the precise scanner looks where the coarse one saw the port; or why not, and once more."""
        try:
            self._config = rough.aimed(self._config)
        except (NoRoughPlaceError, InputError) as error:
            self.problem = error.cause
            self._spoiled += 1
            log.warning("%s", error)
            return
        except PortdockError as error:
            raise MissionFault(FaultCode.PERCEPTION_FAILED, error.cause) from error
        self._rough, self._spoiled = None, 0

    def locate(self) -> PortEstimate | None:
        """What all scans say together; if that is refused, the newest alone. None when the last scan could not be used,
        or was the coarse one."""
        if self._rough is not None:
            if not self.problem:
                self._aim(self._rough)
            return None
        if self.problem or not self._clouds:
            return None
        estimate = self._ask(self._clouds)
        if not estimate.accepted and len(self._clouds) > 1:
            alone = self._ask(self._clouds[-1:])
            return alone if alone.accepted else estimate
        return estimate

    def _ask(self, clouds: list[Cloud]) -> PortEstimate:
        """Perception works in its own process; the tick goes on meanwhile."""
        try:
            future = self._cell.locator.submit(clouds, self._prior())
        except PortdockError as error:
            raise MissionFault(FaultCode.PERCEPTION_FAILED, error.cause) from error
        self._cell.supervisor.wait(future.done)
        try:
            return future.result()
        except InputError as error:
            return PortEstimate.nothing_found(
                self._config.port.model, self._prior(), "base", error.cause, (("total", 0.0),)
            )
        except PortdockError as error:
            raise MissionFault(FaultCode.PERCEPTION_FAILED, error.cause) from error
        except Exception as error:
            raise MissionFault(FaultCode.PERCEPTION_FAILED, f"{type(error).__name__}: {error}") from error

    def _prior(self) -> Prior:
        port = self._config.port
        tilt, roll = np.deg2rad([port.tilt_deg, port.roll_deg])
        return Prior(port.T_base_port.pose, port.lateral_mm / 1000.0, port.along_mm / 1000.0, float(tilt), float(roll))


def plan_view(config: SiteConfig, number: int) -> tuple[Viewpoint, ...]:
    """The passes of the sweep from the configured viewpoint with this number, counted round."""
    views = config.scan.viewpoints
    return plan_passes(
        config.port.T_base_port.pose,
        views[number % len(views)],
        config.scan,
        load_port(config.port.model).shape,
        scanner_facts(config.scanner).window_m,
        config.scanner.T_flange_scanner.pose,
        config.arm.T_flange_tcp.pose,
    )
