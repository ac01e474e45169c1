"""What an operator does at the pendant after an emergency stop: power on, brakes released, over the dashboard."""

from __future__ import annotations

import logging
import socket
import time
from typing import TextIO

log = logging.getLogger(__name__)

DASHBOARD_PORT = 29999
PATIENCE_S = 20.0


def power_on(host: str) -> None:
    """Power the (mock) arm on and release its brakes, if it is not running. A failure shows in the reset after it."""
    try:
        with socket.create_connection((host, DASHBOARD_PORT), timeout=5.0) as line, line.makefile("r") as answers:
            answers.readline()
            end_s = time.monotonic() + PATIENCE_S
            while "RUNNING" not in _ask(line, answers, "robotmode") and time.monotonic() < end_s:
                for command in ("close safety popup", "power on", "brake release"):
                    _ask(line, answers, command)
                time.sleep(0.2)
    except OSError as error:
        log.warning("the dashboard of %s does not answer: %s", host, error)


def _ask(line: socket.socket, answers: TextIO, command: str) -> str:
    line.sendall(command.encode() + b"\n")
    return answers.readline()
