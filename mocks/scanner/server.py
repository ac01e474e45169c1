"""Runs one mock scanner on its line: reads commands, collects profiles, pumps the wire, until told to stop."""

from __future__ import annotations

import logging
import queue
import select
import threading
from collections.abc import Callable
from typing import Protocol

from mocks.scanner.emulated_clock import EmulatedClock
from mocks.scanner.paced_wire import PacedWire
from mocks.scanner.pty_line import PtyLine

logger = logging.getLogger(__name__)

TICK_S = 0.002


class Device(Protocol):
    """What sits behind the line."""

    def receive(self, data: bytes) -> None:
        """Bytes from the client."""

    def collect(self) -> None:
        """Hand to the wire what became ready by itself."""

    def stop(self) -> None:
        """Power off."""


def serve(
    device: Device,
    line: PtyLine,
    wire: PacedWire,
    clock: EmulatedClock,
    stopping: threading.Event,
    requests: queue.SimpleQueue[Callable[[], None]],
) -> None:
    """Until ``stopping`` is set. Wakes at once for commands and for room in the client's buffer, else every TICK_S.

    :param requests: what others (signal handlers) want done between two turns of this loop
    """
    try:
        while not stopping.is_set():
            while not requests.empty():
                requests.get()()
            if line.plugged_in:
                waiting = [line.fileno()] if wire.blocked else []
                readable, _, _ = select.select([line.fileno()], waiting, [], TICK_S)
                if readable:
                    device.receive(line.read())
            else:
                stopping.wait(TICK_S)
            device.collect()
            wire.pump(clock.now_s())
    finally:
        device.stop()
        logger.info("%d bytes sent, %d lost to overrun", wire.sent_bytes, wire.overrun_bytes)
