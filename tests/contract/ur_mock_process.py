"""Starts the emulated UR controller as a process of its own, and a world for it to touch."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mocks.ur.kinematics import MODELS, Kinematics
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Pose

T_BASE_PORT = Pose.from_vector([0.95, 0.1, 0.45, *np.deg2rad([69.2820323, -69.2820323, -69.2820323])])
T_PORT_TCP = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.049]))
T_FLANGE_TCP = Pose.from_vector([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
_started = 0


class MockUr:
    """One emulated controller on a loopback address of its own."""

    def __init__(self, *arguments: str, rate: int = 125) -> None:
        self._arguments = [*arguments, "--rate", str(rate), "--control"]

    def __enter__(self) -> MockUr:
        for _ in range(20):
            self.host = _next_host()
            command = [sys.executable, "-m", "mocks.ur", "--host", self.host, *self._arguments]
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
            line = self._line()
            if line:
                self.ports = json.loads(line)["ports"]
                return self
            self.process.wait(10.0)
        raise RuntimeError("no loopback address was free")

    def __exit__(self, *exception: object) -> None:
        self.process.stdin.close()  # type: ignore[union-attr]
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.log = self.process.stderr.read()  # type: ignore[union-attr]
        for stream in (self.process.stdout, self.process.stderr):
            stream.close()  # type: ignore[union-attr]

    def do(self, what: str, **arguments: Any) -> dict[str, Any]:
        """One line of the control channel."""
        self.process.stdin.write(json.dumps({"do": what, **arguments}) + "\n")  # type: ignore[union-attr]
        self.process.stdin.flush()  # type: ignore[union-attr]
        answer: dict[str, Any] = json.loads(self._line())
        assert "error" not in answer, answer
        return answer

    def state(self) -> dict[str, Any]:
        """What the controller is doing."""
        return self.do("state")

    def until(self, holds: Callable[[dict[str, Any]], bool], emulated_s: float = 20.0) -> dict[str, Any]:
        """The first state that fulfils the condition, within so much emulated time."""
        first = state = self.state()
        deadline = time.monotonic() + 60.0
        while not holds(state):
            late = state["time_s"] > first["time_s"] + emulated_s or time.monotonic() > deadline
            assert not late, f"condition not reached: {state}"
            time.sleep(0.01)
            state = self.state()
        return state

    def _line(self) -> str:
        return self.process.stdout.readline()  # type: ignore[union-attr]


def still(state: dict[str, Any]) -> bool:
    """The arm is at rest."""
    return max(abs(speed) for speed in state["qd"]) < 1e-6


def run_client(code: str, host: str, timeout_s: float = 20.0) -> subprocess.CompletedProcess[str]:
    """Run ur_rtde code in a process of its own: its constructors hold the GIL and a lost link may crash it."""
    return subprocess.run(
        [sys.executable, "-c", code, host], capture_output=True, text=True, timeout=timeout_s, check=False
    )


def start_client(code: str, host: str) -> subprocess.Popen[str]:
    """The same in the background."""
    return subprocess.Popen(
        [sys.executable, "-c", code, host], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )


def make_world(folder: Path, error: Pose, time_scale: float = 1.0, **spec: Any) -> Blackboard:
    """A run folder whose arm starts with the plug 15 mm in front of the rim, off by ``error`` in port axes."""
    before_rim = Pose(T_PORT_TCP.rotation, np.array([0.0, 0.0, 0.015]))
    T_base_tcp = T_BASE_PORT @ Pose(np.eye(3), error.translation) @ Pose(error.rotation, np.zeros(3)) @ before_rim
    flange = (T_base_tcp @ T_FLANGE_TCP.inverse()).matrix
    q = Kinematics(MODELS["ur10e"]).inverse(flange, np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0]))
    assert q is not None
    WorldSpec(
        seed=1,
        port="ccs2",
        T_base_port=tuple(T_BASE_PORT.vector),  # type: ignore[arg-type]
        T_flange_scanner=(0.0,) * 6,  # type: ignore[arg-type]
        T_flange_tcp=tuple(T_FLANGE_TCP.vector),  # type: ignore[arg-type]
        T_port_tcp=tuple(T_PORT_TCP.vector),  # type: ignore[arg-type]
        time_scale=time_scale,
        start_joints=tuple(q),
        **spec,
    ).save(folder)
    return Blackboard.create(folder, time_scale)


def _next_host() -> str:
    global _started
    _started += 1
    return f"127.{20 + os.getpid() % 100}.{(os.getpid() // 100) % 250}.{_started % 250 + 1}"
