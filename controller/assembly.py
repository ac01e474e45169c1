"""A cell put together and live: perception ready, links open, supervisor ticking. Dry run, soak and daemon begin here.

Everything is closed in reverse order when the ``ExitStack`` that was handed in is left, whatever happened.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

from controller import wiring
from controller.cell import Cell, CommandLog, Locator
from controller.config import SiteConfig
from controller.memory import keep_little
from controller.pace import PacedClock
from controller.perception_worker import PerceptionWorker, PreparedModel
from controller.port_files import load_port
from controller.rough_look import CoarseStage
from controller.scanner_facts import scanner_facts
from controller.sources import Sources
from controller.supervisor import Supervisor
from drivers.base import ByteSink, Clock, MonotonicClock
from drivers.processor_time import keep_out_of_collections, keep_time
from perception.geometry import Pose


class Evidence(ByteSink, CommandLog, Protocol):
    """Where the links' traffic and the gate's decisions go: a recorder, or what stands for one."""


@dataclass(frozen=True, slots=True)
class Assembly:
    """A live cell."""

    cell: Cell
    model: PreparedModel
    T_port_tcp_mated: Pose
    coarse: CoarseStage | None = None
    """What looks first, where the site has it."""


def assemble(
    config: SiteConfig,
    evidence: Evidence,
    closing: ExitStack,
    *,
    pace: float = 1.0,
    heartbeat_mode: int = 2,
    alive: Callable[[], None] = lambda: None,
) -> Assembly:
    """Open everything and start the tick. Raises LinkOpenError, and ConfigError before anything is opened."""
    keep_time()
    keep_little()
    wall = MonotonicClock()
    clock = PacedClock(pace, wall)
    devices = wiring.build_devices(config, evidence, wall)
    locator = PerceptionWorker(config.port.model)
    closing.callback(locator.close)
    model = locator.prepared()
    keep_out_of_collections()
    for device in (devices.charger, devices.scanner, devices.coarse, devices.arm, devices.car):
        if device is not None:
            device.open()
            closing.callback(device.close)
    sources = Sources(devices.arm, devices.charger, devices.scanner)
    supervisor = Supervisor(sources, clock, wall, config.host.stall_ms / 1000.0, alive)
    supervisor.facts.mode = heartbeat_mode
    devices.charger.alert(supervisor.wake)
    supervisor.start()
    closing.callback(supervisor.close)
    cell = cell_of(config, devices, locator, supervisor, clock, wall, evidence)
    coarse = None if devices.coarse is None else CoarseStage(devices.coarse, locator.submit_rough)
    return Assembly(cell, model, mated_pose(config), coarse)


def cell_of(
    config: SiteConfig,
    devices: wiring.Devices,
    locator: Locator,
    supervisor: Supervisor,
    clock: PacedClock,
    wall: Clock,
    evidence: CommandLog,
) -> Cell:
    """The cell of open devices: what the configuration says of limits, reach and latency, put in its place."""
    return Cell(
        arm=devices.arm,
        scanner=devices.scanner,
        charger=devices.charger,
        locator=locator,
        supervisor=supervisor,
        clock=clock,
        wall=wall,
        limits=wiring.limits_of(config, load_port(config.port.model)),
        reach=wiring.reach_check(config, devices.arm),
        records=evidence,
        profile_latency_s=scanner_facts(config.scanner).latency_s,
        time_scale=clock.factor,
        car=devices.car,
        coarse=devices.coarse,
    )


def mated_pose(config: SiteConfig) -> Pose:
    """``T_port_tcp`` of the mated plug: as taught at this site, else as the port's description has it."""
    taught = config.port.T_port_tcp
    return load_port(config.port.model).T_port_tcp if taught is None else taught.pose
