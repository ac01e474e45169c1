"""Makes the faults of the catalogue in a live dry run."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from controller.cell import Cell
from controller.mock_cell import MockCell
from perception.errors import PortdockError
from perception.estimate import PortEstimate, Prior
from perception.scan import Cloud


@dataclass(frozen=True, slots=True)
class Scene:
    """What a fault can be made in."""

    mocks: MockCell
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


MAKE: dict[str, Callable[[Scene], None]] = {
    "emergency-stop": lambda scene: scene.mocks.press_estop(True),
    "arm-frozen": lambda scene: scene.mocks.freeze("ur"),
    "charger-frozen": lambda scene: scene.mocks.freeze("charger"),
    "scanner-frozen": lambda scene: scene.mocks.freeze("scanner"),
    "stop": lambda scene: scene.cell.supervisor.request_stop(),
    "abort": lambda scene: scene.cell.supervisor.request_abort(),
    "perception-refuses": _refuse,
    "worker-killed": _kill_workers,
    "disk-full": _fill_disk,
}
"""One for each fault of ``rules.FAULTS``."""
