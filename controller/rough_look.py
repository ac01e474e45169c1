"""The coarse stage: one sweep with a second scanner, and with what it finds the precise one is aimed.

A range finder's ranges are good to centimetres: that is no pose to dock with, and none comes out of here. What comes
out is a site whose port is expected elsewhere; how far off it may then still be, ``port.lateral_mm`` and ``along_mm``
say as before, and the precise scan alone decides what is accepted.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace

from controller.cell import Cell
from controller.coarse_config import CoarseConfig
from controller.config import SiteConfig, ViewpointConfig
from controller.config_section import PoseConfig
from controller.faults import FaultCode, MissionFault
from controller.passes import plan_passes, port_height_m, port_width_m
from controller.planning import Viewpoint
from controller.port_files import load_port
from controller.scanner_facts import scanner_facts
from controller.sweeping import ProgressReport, run_sweep
from drivers.base import LinkLostError, Scanner
from perception.errors import PortdockError
from perception.estimate import Prior
from perception.rough import RoughPlace
from perception.scan import Cloud

log = logging.getLogger(__name__)

FindRoughly = Callable[[Cloud, Prior], Future[RoughPlace]]


@dataclass(frozen=True, slots=True)
class CoarseStage:
    """The second scanner and who makes sense of its scan."""

    scanner: Scanner
    find: FindRoughly


class RoughLook:
    """One coarse sweep at a time, until it has found the port."""

    def __init__(self, cell: Cell, config: SiteConfig, coarse: CoarseConfig, stage: CoarseStage) -> None:
        self._stage = stage
        self._config = _as_coarse_site(config, coarse)
        self._prior = _prior(config, coarse)
        self._cell = replace(
            cell, scanner=stage.scanner, profile_latency_s=scanner_facts(self._config.scanner).latency_s
        )
        self._cloud: Cloud | None = None

    def passes(self) -> tuple[Viewpoint, ...]:
        """The sweep: squarely over everywhere that the port may be."""
        config = self._config
        return plan_passes(
            config.port.T_base_port.pose,
            ViewpointConfig(),
            config.scan,
            load_port(config.port.model).shape,
            scanner_facts(config.scanner).window_m,
            config.scanner.T_flange_scanner.pose,
            config.arm.T_flange_tcp.pose,
        )

    def sweep(self, report: ProgressReport) -> None:
        """Raises MissionFault, SweepError."""
        try:
            if not self._stage.scanner.health().up:  # lost in an earlier mission: a reset opens the precise one only
                self._stage.scanner.close()
                self._stage.scanner.open()
            self._cloud = run_sweep(self._cell, self._config, self.passes(), report).to_cloud()
        except LinkLostError as error:
            raise MissionFault(FaultCode.SCANNER_LINK_LOST, f"coarse scanner: {error.cause}") from error

    def aimed(self, config: SiteConfig) -> SiteConfig:
        """The site with its port where the sweep saw it. Raises PortdockError where it saw none."""
        assert self._cloud is not None, "a sweep comes first"
        future = self._stage.find(self._cloud, self._prior)
        self._cell.supervisor.wait(future.done)
        place = future.result()
        facts = f"correlation {place.correlation:.2f} over {place.points} points"
        if not place.found:
            raise NoRoughPlaceError(f"the coarse scan shows no port where it may be ({facts})")
        offset_mm = 1e3 * (self._prior.T_ref_port.inverse() @ place.T_ref_port).translation
        log.info("coarse scan: the port is %.0f, %.0f, %.0f mm off its expected place (%s)", *offset_mm, facts)
        port = config.port.model_copy(update={"T_base_port": PoseConfig.of(place.T_ref_port)})
        return config.model_copy(update={"port": port})


class NoRoughPlaceError(PortdockError):
    """The coarse scan does not show the port."""

    code = "no-rough-place"
    default_remedy = "Check that the port's cover is open and the car is parked within coarse.lateral_mm."


def _as_coarse_site(config: SiteConfig, coarse: CoarseConfig) -> SiteConfig:
    """The site as the coarse sweep needs it: its scanner, and a sweep over all places where the port may be."""
    shape = load_port(config.port.model).shape
    scan = config.scan.model_copy(
        update={
            "standoff_mm": coarse.standoff_mm,
            "speed_mm_s": coarse.speed_mm_s,
            "length_mm": 2.0 * coarse.lateral_mm + 1e3 * port_height_m(shape),
            "width_mm": 2.0 * coarse.lateral_mm + 1e3 * port_width_m(shape),
        }
    )
    return config.model_copy(update={"scanner": coarse.scanner, "scan": scan})


def _prior(config: SiteConfig, coarse: CoarseConfig) -> Prior:
    return Prior(config.port.T_base_port.pose, coarse.lateral_mm / 1000.0, coarse.along_mm / 1000.0)
