"""The parent's hold on the control worker: starts it, talks to it, and notices within 100 ms when it is no more.

A worker that has crashed or ended closes its socket, which is seen at once. One that hangs is known by its silence, or
by a call of ur_rtde that takes longer than any sound call does; it is killed then, and the controller's watchdog stops
the arm. A worker is used once: after a loss, start a new one.
"""

from __future__ import annotations

import logging
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from drivers.arm import messages as m
from drivers.arm.errors import ControlLinkLostError

log = logging.getLogger(__name__)

SILENCE_S = 0.08
"""A worker that sends no beat for this long, and is not merely waiting for a processor, hangs."""
STARVED_S = 1.0
"""Longest silence that a busy processor excuses."""
CALL_S = 2.0
"""No sound call of ur_rtde that the worker makes takes longer."""
KICK_S = 0.5
"""Nor does a kick take longer than this."""
LOOK_S = 0.01
QUIT_S = 1.5
ROOT = Path(__file__).resolve().parents[2]


class WorkerClient:
    """One worker process and the line to it. Thread-safe."""

    def __init__(self, on_lost: Callable[[str], None], patience: float = 1.0) -> None:
        """``on_lost`` is called once, from the monitor thread, with the reason. ``patience`` stretches all limits."""
        self._on_lost = on_lost
        self._patience = patience
        self._send_lock = threading.Lock()
        self._changed = threading.Condition()
        self._replies: dict[int, m.Reply] = {}
        self._number = 0
        self._started: m.Started | m.StartFailed | None = None
        self._status = m.Status(False, 0, "idle")
        self._status_s = -1.0
        self._lost: str | None = None
        self._quitting = False
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the worker
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "drivers.arm.ur_worker", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])},
                stdin=subprocess.DEVNULL,
                stdout=self._stderr,
                stderr=self._stderr,
                # A Ctrl-C at the terminal is the parent's to handle. Not a new session: Linux may give that a share of
                # the processors of its own, and ur_rtde spins while it waits: it would use up the others' time.
                process_group=0,
            )
        self._connection = Connection(ours.detach())
        self._monitor = threading.Thread(target=self._watch, name="arm-worker-monitor", daemon=True)

    @property
    def pid(self) -> int:
        """The worker's process id."""
        return self._process.pid

    @property
    def lost(self) -> str | None:
        """Why the worker is no more, or None."""
        return self._lost

    @property
    def status(self) -> m.Status:
        """What the control link said last."""
        return self._status

    @property
    def status_s(self) -> float:
        """When it said so, on the monotonic clock."""
        return self._status_s

    # --- talking -----------------------------------------------------------------------------------------------------

    def start(self, start: m.Start, timeout_s: float) -> m.Started | m.StartFailed:
        """Let the worker open its link. ur_rtde's constructor may take seconds and cannot be interrupted."""
        self._send(start)
        self._start_deadline_s = time.monotonic() + timeout_s
        self._monitor.start()
        with self._changed:
            self._changed.wait_for(lambda: self._started is not None or self._lost is not None, timeout_s)
        return self._started or m.StartFailed(self._lost or f"no answer within {timeout_s:.0f} s")

    def ask(self, command: m.Command, timeout_s: float = CALL_S) -> m.Reply:
        """Send one command and wait for its reply. Raises ControlLinkLostError."""
        limit_s = timeout_s * self._patience
        with self._changed:
            self._number += 1
            number = self._number
        self._send(m.Request(number, command))
        with self._changed:
            answered = self._changed.wait_for(lambda: number in self._replies or self._lost is not None, limit_s)
            if number in self._replies:
                return self._replies.pop(number)
        if not answered:
            self._give_up(f"no answer to {type(command).__name__} within {limit_s:.1f} s")
        raise ControlLinkLostError(f"the arm's control link is lost: {self._lost}")

    def kick(self) -> None:
        """Pass one kick on; does not wait. Raises ControlLinkLostError.

        A worker that has not started yet is owed none; one that does not read them has enough, and more would fill the
        line until this call waits for it.
        """
        if self._started is not None and (self._lost is not None or self._takes_more()):
            self._send(m.Kick())

    def quit(self) -> None:
        """Let the worker stop the arm and end; kill it if it does not. Idempotent."""
        self._quitting = True
        if self._lost is None and self._process.poll() is None:
            try:
                self._send(m.Request(0, m.Quit()))
                self._process.wait(QUIT_S)
            except (ControlLinkLostError, subprocess.TimeoutExpired):
                log.warning("the arm's worker did not end when asked to and is killed")
        self._reap()
        if self._monitor.is_alive() and threading.current_thread() is not self._monitor:
            self._monitor.join(QUIT_S)
        self._stderr.close()

    def _send(self, message: object) -> None:
        if self._lost is not None:
            raise ControlLinkLostError(f"the arm's control link is lost: {self._lost}")
        try:
            with self._send_lock:
                self._connection.send(message)
        except OSError as error:
            raise ControlLinkLostError("the arm's control link is lost: its process has ended") from error

    def _takes_more(self) -> bool:
        try:
            return bool(select.select([], [self._connection], [], 0.0)[1])
        except (OSError, ValueError):
            return True  # closed: sending says so

    # --- watching ----------------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        heard_s = time.monotonic()
        busy_reason: str | None = None
        while self._lost is None:
            try:
                while self._connection.poll(LOOK_S if busy_reason is None else 0.0):
                    heard_s = time.monotonic()
                    busy_reason = self._take(self._connection.recv())
            except (EOFError, OSError):
                self._give_up(self._epitaph())
                return
            now_s = time.monotonic()
            if self._started is None:
                if now_s > self._start_deadline_s:
                    self._give_up("it did not start in time")
            elif busy_reason is not None:
                self._give_up(busy_reason)
            elif now_s - heard_s > SILENCE_S * self._patience and self._hangs(now_s - heard_s):
                self._give_up(f"its process hangs: no sign of life for {1000 * (now_s - heard_s):.0f} ms")

    def _hangs(self, silent_s: float) -> bool:
        """Whether silence means a hang. A beat that was sent before the process went to sleep is here by now."""
        starved = silent_s < STARVED_S * self._patience and _starved(self.pid)
        return not starved and not self._connection.poll(0.0)

    def _take(self, message: Any) -> str | None:
        """Sort one message in. Returns why the worker must be taken for hung, or None."""
        with self._changed:
            match message:
                case m.Beat() if self._started and message.busy_for_s > self._patience * (
                    KICK_S if message.busy_with == "kick" else CALL_S
                ):
                    return f"{message.busy_with} has not returned for {message.busy_for_s:.1f} s"
                case m.Status():
                    self._status, self._status_s = message, time.monotonic()
                case m.Reply():
                    self._replies[message.number] = message
                    self._changed.notify_all()
                case m.Started() | m.StartFailed():
                    self._started = message
                    self._changed.notify_all()
                case m.Ended():
                    log.info("the arm's worker ends: %s", message.reason)
                    self._last_words = message.reason
        return None

    _last_words = ""

    def _epitaph(self) -> str:
        """Why the process ended, from its last words or its exit status."""
        try:
            code = self._process.wait(0.05)
        except subprocess.TimeoutExpired:
            return self._last_words or "its process closed the line"
        if self._last_words:
            return self._last_words
        if code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with status {code}"

    def _give_up(self, reason: str) -> None:
        """Declare the worker lost, once, and make sure that it is."""
        with self._changed:
            if self._lost is not None:
                return
            self._lost = reason
            self._changed.notify_all()
        self._reap()
        if not self._quitting:
            log.error("the arm's control worker is lost: %s. %s", reason, self._complaints())
            self._on_lost(reason)

    def _reap(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _complaints(self) -> str:
        """What the library wrote to its standard error, last part."""
        try:
            self._stderr.seek(0)
            return " | ".join(self._stderr.read()[-400:].decode(errors="replace").split("\n")).strip(" |")
        except (OSError, ValueError):
            return ""


def _starved(pid: int) -> bool:
    """Whether a thread of the process could run, or waits for memory: a loaded machine, not a hang."""
    for task in Path(f"/proc/{pid}/task").glob("*/stat"):
        try:
            if task.read_text().rpartition(")")[2].split()[0] in "RD":
                return True
        except (OSError, IndexError):
            continue
    return False
