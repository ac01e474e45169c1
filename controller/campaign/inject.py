"""Makes the faults of the catalogue in a live dry run."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from controller.campaign.faulty_cell import FaultyCell
from controller.cell import Cell
from perception.errors import PortdockError
from perception.estimate import PortEstimate, Prior
from perception.scan import Cloud


@dataclass(frozen=True, slots=True)
class Scene:
    """What a fault can be made in."""

    mocks: FaultyCell
    cell: Cell
    recording: Path


class _Refusing:
    """Perception that raises."""

    def submit(self, clouds: Sequence[Cloud], prior: Prior) -> Future[PortEstimate]:
        """A failure at once."""
        future: Future[PortEstimate] = Future()
        future.set_exception(PortdockError("injected: perception refuses to work on the scan"))
        return future


def _refuse(scene: Scene) -> None:
    scene.cell.locator = _Refusing()


def _kill_workers(scene: Scene) -> None:
    for child in multiprocessing.active_children():
        if child.pid is not None:
            os.kill(child.pid, signal.SIGKILL)


def _fill_disk(scene: Scene) -> None:
    """No file of this process may grow beyond what the recording has now: writing fails as on a full disk."""
    size = max(scene.recording.stat().st_size, 64 * 1024)
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))


def undo_disk() -> None:
    """There is room again."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


LATE_S = 4.0
"""Longer than arm and charger may be silent in a dry run (``for_mocks``)."""
IN_ZONE_S = 3.0
CORRUPTED = 0.01
"""Of a scanner's bytes: hardly a profile is whole."""
JUMP_S = 3600.0


def _enter_zone(scene: Scene) -> None:
    scene.mocks.tell("ur", do="safeguard", open=True)
    scene.mocks.later(IN_ZONE_S, lambda: scene.mocks.tell("ur", do="safeguard", open=False))


def _jump_clock(scene: Scene) -> None:
    """Everything in this process that asks for the time of day is told another hour from now on."""
    time_s, time_ns = time.time, time.time_ns
    time.time = lambda: time_s() + JUMP_S
    time.time_ns = lambda: time_ns() + int(1e9 * JUMP_S)


def _suspend(scene: Scene) -> None:
    """Another process stops this one and lets it go on later."""
    script = f"kill -STOP {os.getpid()}; sleep {LATE_S:g}; kill -CONT {os.getpid()}"
    subprocess.Popen(["sh", "-c", script], stdin=subprocess.DEVNULL)


MAKE: dict[str, Callable[[Scene], None]] = {
    "emergency-stop": lambda scene: scene.mocks.press_estop(True),
    "protective-stop": lambda scene: scene.mocks.tell("ur", do="protective_stop"),
    "zone-entered": _enter_zone,
    "stop": lambda scene: scene.cell.supervisor.request_stop(),
    "abort": lambda scene: scene.cell.supervisor.request_abort(),
    "arm-cut": lambda scene: scene.mocks.tell("ur", do="down", link="all"),
    "arm-frozen": lambda scene: scene.mocks.freeze("ur"),
    "arm-late": lambda scene: scene.mocks.hold_back("ur", LATE_S),
    "charger-cut": lambda scene: scene.mocks.tell("charger", unplug_adapter=True),
    "charger-frozen": lambda scene: scene.mocks.freeze("charger"),
    "charger-late": lambda scene: scene.mocks.hold_back("charger", LATE_S),
    "charger-corrupted": lambda scene: scene.mocks.tell("charger", damaged=True),
    "charger-repeats": lambda scene: scene.mocks.tell("charger", frozen=True),
    "scanner-cut": lambda scene: scene.mocks.unplug_scanner(),
    "scanner-frozen": lambda scene: scene.mocks.freeze("scanner"),
    "scanner-late": lambda scene: scene.mocks.hold_back("scanner", LATE_S),
    "scanner-corrupted": lambda scene: scene.mocks.tell("scanner", flipped=CORRUPTED),
    "lock-jammed": lambda scene: scene.mocks.tell("charger", lock_jammed=True),
    "contactor-welded": lambda scene: scene.mocks.tell("charger", contactor_welded=True),
    "precharge-fails": lambda scene: scene.mocks.tell("charger", precharge_fails=True),
    "perception-refuses": _refuse,
    "worker-killed": _kill_workers,
    "disk-full": _fill_disk,
    "clock-jumps": _jump_clock,
    "host-suspended": _suspend,
    "process-killed": lambda scene: os.kill(os.getpid(), signal.SIGKILL),
}
"""One for each fault of ``rules.FAULTS`` that is not impossible everywhere."""
