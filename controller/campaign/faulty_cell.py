"""The mock cell with levers: while it runs, each mock can be cut off, silenced, spoiled, or told what to suffer.

The mocks take their troubles as JSON lines on standard input (``mocks/ur/control_channel.py``,
``mocks/charger/controls.py``, ``mocks/scanner/controls.py``); the scanner's plug is pulled by a signal.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from controller.mock_cell import MockCell

_WELL_AGAIN: dict[str, tuple[dict[str, Any], ...]] = {
    "ur": (
        {"do": "up", "link": "all"},
        {"do": "safeguard", "open": False},
        {"do": "unlock"},
        {"do": "slider", "fraction": 1.0},
    ),
    "charger": (
        {"damaged": False, "frozen": False, "lock_jammed": False, "contactor_welded": False, "precharge_fails": False},
        {"unplug_adapter": False},
    ),
    "scanner": ({"flipped": 0.0},),
}
"""What takes every trouble out of a mock again without making it forget plug, lock and power."""


class FaultyCell(MockCell):
    """A mock cell whose devices can be troubled while they run."""

    def tell(self, name: str, **trouble: Any) -> None:
        """One control line to the mock ``ur``, ``charger`` or ``scanner``."""
        stdin = self._process(name).stdin
        assert stdin is not None
        stdin.write(json.dumps(trouble) + "\n")
        stdin.flush()

    def unplug_scanner(self) -> None:
        """Its device name vanishes, an open client's line breaks."""
        self._process("scanner").send_signal(signal.SIGUSR1)

    def hold_back(self, name: str, silence_s: float) -> None:
        """Silent for so long, then everything at once, late."""
        self.freeze(name)
        self.later(silence_s, lambda: self._process(name).send_signal(signal.SIGCONT))

    def arm_place_m(self) -> tuple[float, float, float]:
        """Where the mock arm's TCP is, in the base frame. Only while the mock is not frozen."""
        self.tell("ur", do="state")
        stdout = self._process("ur").stdout
        assert stdout is not None
        while "tcp" not in (answer := json.loads(stdout.readline())):
            pass  # the answers to what it was told before
        x, y, z = answer["tcp"][:3]
        return x, y, z

    def later(self, delay_s: float, act: Callable[[], None]) -> None:
        """Do something after a while, unless the cell is gone by then."""

        def act_if_alive() -> None:
            if self._processes:
                act()

        timer = threading.Timer(delay_s, act_if_alive)
        timer.daemon = True
        timer.start()

    def repair(self) -> None:
        """Everything is well again, and plugged in."""
        super().repair()
        for name, lines in _WELL_AGAIN.items():
            for line in lines:
                self.tell(name, **line)
        self._process("scanner").send_signal(signal.SIGUSR2)

    def _start(self, name: str, arguments: list[str], log: str | None = None) -> None:
        """As any mock cell does, with a line to talk over."""
        control = ["--control"] if name == "ur" else []
        with (self._folder / (log or f"mock-{name}.log")).open("w", encoding="utf-8") as file:
            self._processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", "mocks", name, *arguments, *control],
                    stdin=subprocess.PIPE,
                    process_group=0,
                    stdout=subprocess.PIPE,
                    stderr=file,
                    text=True,
                    cwd=self._folder,
                )
            )
