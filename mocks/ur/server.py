"""The emulated controller as a server: one thread, one selector, fixed steps of emulated time.

Emulated time is the blackboard's world time (or a clock of the mock's own when it stands alone). When the process is
late it catches up in fixed steps, as far as ``MAX_LATE_S``; a longer stall of the mock itself is skipped, for the arm
must not travel while nobody could have watched it. The watchdog is judged by the wall clock, since it guards the host.
"""

from __future__ import annotations

import logging
import selectors
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from mocks.ur.controller import Controller
from mocks.ur.dashboard import DashboardClient, DashboardCommands
from mocks.ur.primary import PrimaryClient
from mocks.ur.rtde_server import Ownership, RtdeClient
from mocks.ur.script_server import ScriptClient
from mocks.ur.sockets import Connection, Listener

log = logging.getLogger(__name__)

MAX_LATE_S = 0.1
"""Wall seconds that are caught up."""
TELL_EVERY_S = 10.0
BATCH_S = 0.004
"""Faster than real time, the steps of so many wall seconds are taken together and the newest state is sent."""


class UrServer:
    """A controller behind its ports."""

    def __init__(
        self,
        controller: Controller,
        host: str,
        rate_hz: int,
        world_time_s: Callable[[], float],
        time_scale: float,
        programs: Path | None = None,
        serial_number: str = "20240000001",
    ) -> None:
        self.controller = controller
        self.selector = selectors.DefaultSelector()
        self.ownership = Ownership()
        self.frozen_until = 0.0
        self.skipped_s = 0.0
        self.skips: deque[tuple[float, float]] = deque(maxlen=1000)
        """Emulated time before each stall of the mock that was not caught up, and its length."""
        self.after_step: Callable[[], None] = lambda: None
        self.stopping = False
        self._rate_hz = rate_hz
        self._dt = 1.0 / rate_hz
        self._world_time_s = world_time_s
        self._time_scale = time_scale
        self._kicked_at = time.monotonic()
        self._told_late_s = -TELL_EVERY_S
        controller.on_kick = self._kick
        controller.on_program = self._tell_program
        commands = DashboardCommands(controller, serial_number, programs)
        self.listeners = {
            "rtde": Listener(self.selector, host, 30004, self._rtde_client),
            "dashboard": Listener(self.selector, host, 29999, lambda c: DashboardClient(c, commands)),
            "script": Listener(self.selector, host, 30003, lambda c: ScriptClient(c, controller)),
            "primary": Listener(self.selector, host, 30001, lambda c: PrimaryClient(c, controller)),
            "secondary": Listener(self.selector, host, 30002, lambda c: PrimaryClient(c, controller)),
        }

    def run(self) -> None:
        """Serve until ``stopping``."""
        self.controller.time_s = self._world_time_s()
        while not self.stopping:
            due_in_s = (self.controller.time_s + self._dt - self._world_time_s()) / self._time_scale
            self._poll(max(0.0 if self._time_scale <= 1.0 else BATCH_S, due_in_s))
            self._advance()
        self.close()

    def close(self) -> None:
        """Close every port."""
        for listener in self.listeners.values():
            listener.close()
        self.selector.close()

    def _poll(self, timeout_s: float) -> None:
        for key, events in self.selector.select(timeout_s):
            key.data(events)

    def _advance(self) -> None:
        behind_s = self._world_time_s() - self.controller.time_s
        allowed_s = max(MAX_LATE_S * self._time_scale, 2.0 * self._dt)
        if behind_s > allowed_s:
            steps = int((behind_s - allowed_s) / self._dt)
            self.skips.append((self.controller.time_s, steps * self._dt))
            self.controller.time_s += steps * self._dt
            self.skipped_s += steps * self._dt
            self._tell_lateness()
        self._check_watchdog()
        stepped = False
        while self._world_time_s() >= self.controller.time_s + self._dt and not stepped:
            for _ in range(int((self._world_time_s() - self.controller.time_s) / self._dt)):
                self.controller.tick(self._dt)
                self.after_step()
                stepped = True
                if self._time_scale <= 1.0:
                    self._send_states()
                    self._poll(0.0)  # also while catching up, what clients send is read at once
        if stepped and self._time_scale > 1.0:
            self._send_states()

    def _tell_lateness(self) -> None:
        """Now and then only: whoever started the mock may not read its standard error."""
        now_s = time.monotonic()
        if now_s - self._told_late_s > TELL_EVERY_S:
            self._told_late_s = now_s
            log.warning("the mock is late: %.3f emulated seconds skipped so far", self.skipped_s)

    def _send_states(self) -> None:
        if time.monotonic() < self.frozen_until:
            return
        for name in ("rtde", "primary", "secondary"):
            for connection in self.listeners[name].live():
                if isinstance(connection.handler, RtdeClient | PrimaryClient):
                    connection.handler.send_state()

    def _tell_program(self, title: str, name: str) -> None:
        for connection in self.listeners["primary"].live():
            if isinstance(connection.handler, PrimaryClient):
                connection.handler.send_key(title, name)

    def _rtde_client(self, connection: Connection) -> RtdeClient:
        return RtdeClient(connection, self.controller, self.ownership, float(self._rate_hz))

    def _kick(self) -> None:
        self._kicked_at = time.monotonic()

    def _check_watchdog(self) -> None:
        if self.controller.watched is None:
            return
        if time.monotonic() - self._kicked_at > self.controller.watchdog_timeout_s:
            self.controller.watchdog_expired()
