"""One asynchronous motion as the control script's status register tells it."""

from __future__ import annotations

import time
from typing import Protocol

from drivers.arm import messages as m

START_MOTION_S = 1.0
"""An accepted motion that the script has not begun after this long never will."""


class OperationStatus(Protocol):
    """ur_rtde's AsyncOperationStatus."""

    def operationId(self) -> int: ...
    def isAsyncOperationRunning(self) -> bool: ...


class Motion:
    """A motion asked for by the parent, or the stop of one: a value that is replaced as it advances."""

    def __init__(self, motion_id: int = 0, phase: m.Phase = "idle", operation_before: int = -1) -> None:
        self.motion_id = motion_id
        self.phase = phase
        self._before = operation_before
        self._since_s = time.monotonic()

    def advanced(self, status: OperationStatus, program_running: bool) -> Motion:
        """The motion after a look at the status register, whose operation number changes when one begins."""
        if self.phase not in ("running", "stopping"):
            return self
        if not program_running:
            return Motion(self.motion_id, "failed")
        if status.operationId() == self._before:
            waited = time.monotonic() - self._since_s
            return Motion(self.motion_id, "failed") if waited > START_MOTION_S else self
        return self if status.isAsyncOperationRunning() else Motion(self.motion_id, "done")
