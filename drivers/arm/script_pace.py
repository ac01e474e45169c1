"""When the control script has read what was written last, and when it is ready for the next command.

ur_rtde waits for that by spinning on a lock that its own receiver needs: on a busy machine this keeps the answer, and
all other threads, from the processor. So the worker sleeps first for as long as the script needs at the least.
"""

from __future__ import annotations

import time

READY_CYCLES = 2.0
"""After so many cycles of the link the script has said that it is ready for the next command."""
READ_CYCLES = 2.5
"""After so many cycles it has read what was streamed."""


class ScriptPace:
    """Of one control link. Not thread-safe."""

    def __init__(self, frequency_hz: float) -> None:
        self._get_ready_s = READY_CYCLES / frequency_hz
        self._read_s = READ_CYCLES / frequency_hz
        self._ready_at_s = self._read_at_s = -1.0

    def answered(self) -> None:
        """A command that the script answers has just returned."""
        self._ready_at_s = time.monotonic() + self._get_ready_s

    def streamed(self) -> None:
        """A command that the script takes without an answer was just written for the first time."""
        self._read_at_s = time.monotonic() + self._read_s

    @property
    def has_read(self) -> bool:
        """Whether the script has read what was streamed."""
        return time.monotonic() >= self._read_at_s

    def wait_until_ready(self) -> None:
        """Sleep until the script takes the next command without ur_rtde's spinning."""
        _sleep_until(self._ready_at_s)

    def wait_until_read(self) -> None:
        """Let the script begin a streamed mode before it is told to end it, or it kills what is not there."""
        _sleep_until(self._read_at_s)


def _sleep_until(at_s: float) -> None:
    time.sleep(max(0.0, at_s - time.monotonic()))
