"""The process itself is killed: its mission runs in a child, and what the arm does afterwards is asked of the mock."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import numpy as np

from controller.campaign.faulty_cell import FaultyCell
from controller.campaign.rules import STOPPING_S

LOOK_S = 2.0
"""So long is watched whether the arm stands."""


def run_to_its_death(mission: Callable[[], object]) -> tuple[bool, float]:
    """Run a mission in a child process; whether it was killed, and the host time at which it was gone."""
    child = os.fork()
    if child == 0:
        try:
            mission()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL, time.monotonic()


def drift_after_death_m(mocks: FaultyCell, watchdog_s: float) -> float:
    """How far the arm moves once its own watchdog must have stopped it."""
    time.sleep(watchdog_s + STOPPING_S)
    before = mocks.arm_place_m()
    time.sleep(LOOK_S)
    return float(np.linalg.norm(np.subtract(mocks.arm_place_m(), before)))
