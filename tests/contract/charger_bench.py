"""The real driver against the mock charger's process: started, ticked, and taken down again.

Over a pty with a slcan adapter's bytes; in user-mode Linux (tests/socketcan) over a vcan of its own, on real SocketCAN.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import can

from drivers.base import CanFrame, ChargerRequest, Heartbeat, LinkLostError, MonotonicClock, NullSink, RequestResult
from drivers.charger.can_charger import CanCharger
from drivers.charger.settings import CanSettings

ON_VCAN = "PORTDOCK_IN_UML" in os.environ
SLOWER = 4.0 if ON_VCAN else 1.0
"""That kernel has one processor, and each of its system calls costs several of the host's."""
PATIENT_S = 1.2 * SLOWER
"""Silence that counts as a loss where the loss itself is not the subject: the machine may be busy."""
PATIENT = f"--lost-ms={1000 * PATIENT_S:.0f}"
QUICK = "--time-scale=25"
OPEN = (RequestResult.PENDING, RequestResult.ACCEPTED, RequestResult.BUSY)
ESTOP_OK, HOLDS_PLUG, CLEAR, MATED = 1, 1 << 2, 1 << 4, 1 << 5


_numbers = itertools.count(1)


def _new_vcan() -> str:
    """A virtual CAN network of its own, so that no two mock chargers share one. It lives as long as the kernel."""
    name = f"vcan{next(_numbers)}"
    for command in (f"link add dev {name} type vcan", f"link set {name} mtu 72", f"link set {name} up"):
        subprocess.run(["ip", *command.split()], check=True)
    return name


class FrameLog(NullSink):
    """Keeps every CAN frame."""

    def __init__(self) -> None:
        self.frames: list[CanFrame] = []

    def can_frame(self, frame: CanFrame) -> None:
        self.frames.append(frame)


class MockProcess:
    """``python -m mocks.charger`` on a pty behind a symlink, or on a bus of python-can."""

    def __init__(self, folder: Path, *options: str, taps: int = 0, on: tuple[str, str] | None = None) -> None:
        if ON_VCAN and on is None:
            on = ("socketcan", _new_vcan())
        self.link = folder / "can0" if on is None else Path(on[1])
        self.taps = [folder / f"tap{k}" if on is None else self.link for k in range(taps)]
        links = [f"--link={link}" for link in (self.link, *self.taps)]
        if on is not None:
            links = [f"--interface={on[0]}", f"--channel={on[1]}"]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "mocks.charger", *links, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.says: dict[str, Any] = json.loads(self._process.stdout.readline())

    def control(self, **values: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(values) + "\n")
        self._process.stdin.flush()

    def fresh(self) -> MockProcess:
        """As after power-on: for tests that share one process."""
        self.control(reboot=True)
        return self

    def stop(self) -> int:
        self._process.terminate()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        return self._process.wait(10)


class Bench:
    """Driver and mock; ``until`` is the supervisor's tick."""

    def __init__(self, mock: MockProcess, **settings: Any) -> None:
        settings = {"degraded_s": 0.6 * PATIENT_S, "lost_s": PATIENT_S, "sleep_after_open_s": 0.02} | settings
        self.mock = mock
        self.log = FrameLog()
        self.settings = CanSettings(interface=mock.says["interface"], channel=mock.says["channel"], **settings)
        self.charger = CanCharger(self.settings, MonotonicClock(), self.log)
        self.flags = ESTOP_OK | HOLDS_PLUG
        self.beating = True
        self._beat_s = 0.0

    def close(self) -> None:
        self.charger.close()

    def until(self, condition: Callable[[], Any], timeout_s: float = 10.0) -> None:
        """Tick until the condition holds; fails with what is known when it does not in time.

        A condition that finds the charger lost does not hold yet: a machine that stalls loses it for a moment.
        """
        end_s = time.monotonic() + timeout_s * SLOWER
        while not _holds(condition):
            assert time.monotonic() < end_s, f"never happened; {self.charger.health()}"
            self.tick()
            time.sleep(0.005)

    def tick(self) -> None:
        if self.beating and time.monotonic() - self._beat_s >= 0.045:
            self._beat_s = time.monotonic()
            self.charger.heartbeat(Heartbeat(mode=2, state=3, flags=self.flags, cycle_id=1))

    def ask(self, request: ChargerRequest, argument: int = 0) -> RequestResult:
        number = self.charger.request(request, argument)
        self.until(lambda: self.charger.result(number) not in OPEN)
        return self.charger.result(number)

    def must(self, *requests: ChargerRequest) -> None:
        for request in requests:
            assert self.ask(request) is RequestResult.DONE, (request, self.charger.refusal())

    def welcome(self) -> None:
        """Open, and be heard by the charger."""
        self.charger.open()
        self.until(lambda: not self.charger.status().motion_inhibit)

    def mate(self) -> None:
        """Up to a locked plug that force says is mated."""
        self.welcome()
        self.must(ChargerRequest.RESERVE, ChargerRequest.UNLOCK_DOCK)
        self.mock.control(plugged=True)
        self.until(lambda: self.charger.status().proximity == 1)
        self.must(ChargerRequest.LOCK_PLUG)
        self.flags |= MATED

    def charge(self) -> None:
        """Up to 100 A."""
        self.mate()
        self.must(ChargerRequest.ENABLE_POWER)
        self.until(lambda: self.charger.status().current_a > 100.0)


def _holds(condition: Callable[[], Any]) -> bool:
    with contextlib.suppress(LinkLostError):
        return bool(condition())
    return False


def tap(link: Path) -> can.BusABC:
    """Another host on the same bus."""
    if ON_VCAN:
        return can.Bus(interface="socketcan", channel=link.name, ignore_config=True)
    return can.Bus(interface="slcan", channel=str(link), bitrate=250_000, sleep_after_open=0.05, ignore_config=True)


def drain(bus: can.BusABC, seconds: float) -> Sequence[can.Message]:
    """Everything that arrives within a while."""
    messages, end_s = [], time.monotonic() + seconds
    while time.monotonic() < end_s:
        message = bus.recv(0.02)
        if message is not None:
            messages.append(message)
    return messages
