"""An emulated controller in its own process, with faults at will, and the real arm driver in front of it."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from drivers.arm.settings import UrSettings
from drivers.arm.ur import UrArm
from drivers.base import ArmCommandRecord, ArmState, MotionProgress, NullSink
from perception.geometry import Pose

T_FLANGE_TCP = Pose.from_vector([0.0, 0.0, 0.2, 0.0, 0.0, 0.3])
PAYLOAD_KG = 2.5
COG_M = (0.0, 0.01, 0.06)
WATCHDOG_S = 0.5

_count = itertools.count()


def own_address() -> str:
    """A loopback address that no other test of this run, or of a run beside it, uses."""
    number = next(_count)
    return f"127.{64 + os.getpid() % 128}.{1 + number // 250}.{1 + number % 250}"


def until(condition: Callable[[], bool], what: str, timeout_s: float = 10.0) -> float:
    """Poll a condition; returns how long it took."""
    begun = time.monotonic()
    while not condition():
        if time.monotonic() - begun > timeout_s:
            raise AssertionError(f"within {timeout_s} s: {what}")
        time.sleep(0.005)
    return time.monotonic() - begun


class MockController:
    """``python -m mocks.ur`` on an address of its own."""

    def __init__(self, *options: str) -> None:
        self.host = own_address()
        command = [sys.executable, "-m", "mocks.ur", "--host", self.host, "--rate", "125", "--control", *options]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self.process.stdout is not None
        assert json.loads(self.process.stdout.readline())["host"] == self.host

    def do(self, action: str, **arguments: object) -> dict:
        """Apply a fault or operator's action; returns the mock's answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps({"do": action, **arguments}) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        assert "error" not in answer, answer
        return answer

    def state(self) -> dict:
        """What the emulated controller is really doing."""
        return self.do("state")

    def still(self) -> bool:
        """Whether the emulated arm stands still."""
        return max(map(abs, self.state()["qd"])) < 1e-4

    def until_still(self, timeout_s: float = 5.0) -> float:
        """Wait for it; then make sure that it stays still for a while of emulated time."""
        took = until(self.still, "the emulated arm stands still", timeout_s)
        before = self.state()
        until(lambda: self.state()["time_s"] > before["time_s"] + 0.3, "emulated time goes on")
        after = self.state()
        assert max(abs(a - b) for a, b in zip(before["q"], after["q"], strict=True)) < 1e-4, "it moved again"
        return took

    def kill(self) -> None:
        """As if its plug were pulled."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def close(self) -> None:
        """End it, however it is."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                stream.close()


class Sink(NullSink):
    """Keeps what a recorder would."""

    def __init__(self) -> None:
        self.states: list[ArmState] = []
        self.commands: list[ArmCommandRecord] = []

    def arm_state(self, state: ArmState) -> None:
        self.states.append(state)

    def arm_command(self, record: ArmCommandRecord) -> None:
        self.commands.append(record)


class Kicker:
    """Stands in for the supervisor's tick: 100 kicks a second while it is on."""

    def __init__(self, arm: UrArm) -> None:
        self._arm = arm
        self._on = threading.Event()
        self._end = threading.Event()
        self.errors: list[Exception] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._on.set()
        self._thread.start()

    def _run(self) -> None:
        while not self._end.wait(0.01):
            if self._on.is_set():
                try:
                    self._arm.kick_watchdog()
                except Exception as error:  # a lost link is what many tests are about
                    self.errors.append(error)

    def pause(self) -> None:
        self._on.clear()

    def resume(self) -> None:
        self._on.set()

    def close(self) -> None:
        self._end.set()
        self._thread.join()


def settings(host: str, **changes: object) -> UrSettings:
    """An ur10e with a plug, at the emulated controller's rate; patient enough for a busy machine."""
    values: dict = {"model": "ur10e", "T_flange_tcp": T_FLANGE_TCP, "payload_kg": PAYLOAD_KG}
    values |= {"watchdog_hz": 1.0 / WATCHDOG_S, "freshness_s": 1.0}
    values |= {"centre_of_gravity_m": COG_M, "frequency_hz": 125.0, **changes}
    return UrSettings(host, **values)


class Rig:
    """Controller, driver and kicks, all running."""

    def __init__(self, *options: str, **changes: object) -> None:
        self.mock = MockController(*options)
        self.sink = Sink()
        self.arm = UrArm(settings(self.mock.host, **changes), self.sink)
        try:
            self.arm.open()
        except BaseException:
            self.mock.close()
            raise
        self.home = self.arm.state().T_base_tcp
        self.kicker = Kicker(self.arm)

    def finish(self, motion_id: int, timeout_s: float = 15.0) -> MotionProgress:
        """Wait for a motion to end."""
        until(lambda: not self.arm.motion().running, f"motion {motion_id} ends", timeout_s)
        progress = self.arm.motion()
        assert progress.motion_id == motion_id
        return progress

    def until_moving(self) -> None:
        """Wait until the emulated arm really moves."""
        until(lambda: self.arm.state().moving, "the arm moves")

    def close(self) -> None:
        self.kicker.close()
        self.arm.close()
        self.mock.close()


_HOST_PROCESS = """
import sys, time
import numpy as np
from tests.arm_rig import Kicker, settings
from drivers.arm.ur import UrArm

arm = UrArm(settings(sys.argv[1]))
arm.open()
kicker = Kicker(arm)
arm.move_velocity(np.array([0.0, 0.0, float(sys.argv[2]), 0.0, 0.0, 0.0]), 0.5)
print(arm._links.worker.pid, flush=True)
time.sleep(60)
"""


def host_process(mock: MockController, velocity_m_s: float = 0.02) -> tuple[subprocess.Popen[str], int]:
    """Another process that drives the arm at a steady velocity, and its control worker's process id."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, "-c", _HOST_PROCESS, mock.host, str(velocity_m_s)]
    host = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert host.stdout is not None
    return host, int(host.stdout.readline())


__all__ = ["Kicker", "MockController", "Rig", "Sink", "host_process", "own_address", "settings", "until"]
