"""Faults and operator's actions for one emulated controller, as JSON lines on its standard input.

Each line is an object with the key ``do`` and its arguments; each is answered with one JSON line on standard output::

    {"do": "protective_stop"}                {"do": "unlock"}
    {"do": "stop"}                           the running program, as the operator would
    {"do": "estop"}                          {"do": "release_estop"}
    {"do": "safeguard", "open": true}        {"do": "safety", "mode": "FAULT"}
    {"do": "remote", "on": false}            {"do": "slider", "fraction": 0.5}
    {"do": "freeze", "seconds": 2.5}         no RTDE data goes out, connections stay
    {"do": "drop", "link": "rtde"}           reset of the live connections of rtde, dashboard, script or all
    {"do": "down", "link": "all"}            ports closed as well; {"do": "up", ...} opens them again
    {"do": "registers_in_use", "names": ["input_int_register_0"]}
    {"do": "script_starts", "on": false}     uploaded scripts are ignored
    {"do": "digital_in", "bits": 1}
    {"do": "commands"}                       host's monotonic time and number of the last control-script commands
    {"do": "kicks"}                          host's monotonic times of the last writes of the watched register
    {"do": "skips"}                          emulated times at which the mock was late, and the seconds it left out
    {"do": "state"}                          answers with what the controller is doing
"""

from __future__ import annotations

import json
import os
import selectors
import time
from collections.abc import Callable
from typing import Any, TextIO

from mocks.ur.server import UrServer
from mocks.ur.sockets import Listener
from mocks.ur.state import PowerMode, Safety

Fault = dict[str, Any]


class ControlChannel:
    """Reads the lines and applies them."""

    def __init__(self, server: UrServer, descriptor: int, replies: TextIO) -> None:
        self._server = server
        self._controller = server.controller
        self._descriptor = descriptor
        self._replies = replies
        self._buffer = b""
        self._actions: dict[str, Callable[[Fault], object]] = {
            "protective_stop": lambda fault: self._controller.protective_stop(),
            "stop": lambda fault: self._controller.stop_program(),
            "unlock": lambda fault: self._controller.unlock_protective_stop(),
            "estop": lambda fault: self._controller.emergency_stop(),
            "release_estop": lambda fault: self._controller.release_emergency_stop(),
            "safeguard": lambda fault: self._controller.safeguard(bool(fault["open"])),
            "safety": self._safety,
            "remote": lambda fault: setattr(self._controller, "remote", bool(fault["on"])),
            "slider": lambda fault: setattr(self._controller.arm, "slider", float(fault["fraction"])),
            "freeze": self._freeze,
            "drop": lambda fault: self._each(fault, Listener.drop),
            "down": lambda fault: self._each(fault, Listener.close),
            "up": lambda fault: self._each(fault, Listener.open),
            "registers_in_use": self._registers_in_use,
            "script_starts": lambda fault: setattr(self._controller, "script_starts", bool(fault["on"])),
            "digital_in": lambda fault: setattr(self._controller.io, "digital_in", int(fault["bits"])),
            "commands": lambda fault: {"commands": list(self._controller.commands)},
            "kicks": lambda fault: {"kicks": list(self._controller.kicks)},
            "skips": lambda fault: {"skips": list(self._server.skips)},
            "state": self._state,
        }
        server.selector.register(descriptor, selectors.EVENT_READ, self._ready)

    def _ready(self, events: int) -> None:
        data = os.read(self._descriptor, 65536)
        if not data:
            self._server.selector.unregister(self._descriptor)
            self._server.stopping = True
            return
        self._buffer += data
        while b"\n" in self._buffer:
            line, self._buffer = self._buffer.split(b"\n", 1)
            if line.strip():
                self._replies.write(json.dumps(self._apply(line)) + "\n")
                self._replies.flush()

    def _apply(self, line: bytes) -> object:
        try:
            fault = json.loads(line)
            result = self._actions[fault["do"]](fault)
        except (ValueError, KeyError, TypeError) as error:
            return {"error": f"{type(error).__name__}: {error}"}
        return result if isinstance(result, dict) else {"ok": result is not False}

    def _each(self, fault: Fault, act: Callable[[Listener], None]) -> None:
        links = self._server.listeners
        for listener in links.values() if fault["link"] == "all" else [links[fault["link"]]]:
            act(listener)

    def _safety(self, fault: Fault) -> None:
        self._controller.enter_safety(Safety[fault["mode"]])

    def _freeze(self, fault: Fault) -> None:
        self._server.frozen_until = time.monotonic() + float(fault["seconds"])

    def _registers_in_use(self, fault: Fault) -> None:
        self._server.ownership.reserved = set(fault["names"])

    def _state(self, fault: Fault) -> Fault:
        controller, arm = self._controller, self._controller.arm
        return {
            "time_s": controller.time_s,
            "moved_s": controller.moved_s,
            "q": arm.q.tolist(),
            "qd": arm.qd.tolist(),
            "tcp": controller.tcp_pose.tolist(),
            "tool_speed": controller.tool_speed.tolist(),
            "wrench": arm.true_wrench.tolist(),
            "peak_force_n": controller.peak_force_n,
            "runtime": controller.runtime_state.name,
            "safety": controller.safety.mode.name,
            "power": PowerMode(controller.power.mode).name,
            "program": controller.program_name if controller.program is not None else None,
            "slider": arm.slider,
            "force_mode": arm.force_mode is not None,
            "watchdog": controller.watched,
            "skipped_s": self._server.skipped_s,
        }
