"""A controller without sockets, and a wire that keeps what is sent."""

from __future__ import annotations

import numpy as np

from mocks.ur.arm import Arm, FreeSpace, Sensor
from mocks.ur.controller import Controller
from mocks.ur.kinematics import MODELS, Kinematics

JOINTS = np.array([0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0])


class Wire:
    """Stands for a TCP connection."""

    def __init__(self) -> None:
        self.sent = b""
        self.backlog = False
        self.closed = False

    def send(self, data: bytes) -> None:
        self.sent += data

    def close(self) -> None:
        self.closed = True

    def take(self) -> bytes:
        sent, self.sent = self.sent, b""
        return sent


def new_controller(version: tuple[int, int, int, int] = (5, 15, 0, 7), **options: bool) -> Controller:
    sensor = Sensor(np.random.default_rng(1), 0.0, 0.0, 0.0, 0.0)
    return Controller(Arm(Kinematics(MODELS["ur10e"]), JOINTS, FreeSpace(), sensor), version, **options)


def run(controller: Controller, seconds: float, dt: float = 0.008) -> None:
    for _ in range(round(seconds / dt)):
        controller.tick(dt)
