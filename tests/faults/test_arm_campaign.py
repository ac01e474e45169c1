"""Kills at random moments: whatever dies, the emulated arm stands still within the watchdog's time, and no script
is left running without one. Long: ``make long``.
"""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest

from drivers.arm.ur import UrArm
from drivers.base import LinkLostError
from tests.arm_rig import WATCHDOG_S, Kicker, MockController, host_process, settings, until

ROUNDS = 200
VICTIMS = ("worker", "worker hangs", "link", "host", "host hangs", "robot")
STILL_S = WATCHDOG_S + 0.5
"""Emulated, from the kill to the last movement: the watchdog's period, and room for decelerating and a late mock."""


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_whatever_is_killed_at_whatever_moment_the_arm_stands_still() -> None:
    rng = np.random.default_rng(6)
    mock = MockController()
    try:
        for round_number in range(ROUNDS):
            victim = VICTIMS[int(rng.integers(len(VICTIMS)))]
            direction = 0.03 if mock.state()["tcp"][2] < 0.5 else -0.03
            if victim.startswith("host"):
                kill_host(mock, rng, victim, direction)
            elif victim == "robot":
                kill_robot(rng)
            else:
                kill_link(mock, rng, victim, direction)
            assert mock.state()["program"] is None, f"round {round_number}: {victim} left a script behind"
    finally:
        mock.close()


def pause(rng: np.random.Generator) -> None:
    """Some moment between the command's first byte and steady motion."""
    time.sleep(float(rng.uniform(0.0, 0.4)))


def stands_still_in_time(mock: MockController) -> None:
    begun = mock.state()["time_s"]
    until(lambda: mock.state()["program"] is None and mock.still(), "the script has ended and the arm stands still")
    mock.until_still()
    assert mock.state()["moved_s"] - begun < STILL_S


def kill_link(mock: MockController, rng: np.random.Generator, victim: str, direction: float) -> None:
    arm = UrArm(settings(mock.host))
    arm.open()
    kicker = Kicker(arm)
    try:
        arm.move_velocity(np.array([0.0, 0.0, direction, 0.0, 0.0, 0.0]), 0.5)
        pause(rng)
        if victim == "link":
            mock.do("drop", link="rtde")
        else:
            os.kill(arm._links.worker.pid, signal.SIGKILL if victim == "worker" else signal.SIGSTOP)
        stands_still_in_time(mock)
        until(lambda: not arm.health().up, "the loss is reported")
        assert arm._links.worker.lost
    finally:
        kicker.close()
        arm.close()


def kill_host(mock: MockController, rng: np.random.Generator, victim: str, direction: float) -> None:
    host, _ = host_process(mock, direction)
    try:
        pause(rng)
        host.send_signal(signal.SIGKILL if victim == "host" else signal.SIGSTOP)
        stands_still_in_time(mock)
    finally:
        host.kill()
        host.communicate()


def kill_robot(rng: np.random.Generator) -> None:
    """The controller itself: every call must fail soon, none may hang."""
    mock = MockController()
    arm = UrArm(settings(mock.host))
    try:
        arm.open()
        arm.move_velocity(np.array([0.0, 0.0, 0.03, 0.0, 0.0, 0.0]), 0.5)
        pause(rng)
        mock.kill()
        until(lambda: not arm.health().up, "the loss is reported")
        until(lambda: not arm._links.fresh, "state is stale")
        begun = time.monotonic()
        with pytest.raises(LinkLostError):
            arm.state()
        with pytest.raises(LinkLostError):
            arm.stop()
        assert time.monotonic() - begun < 5.0
    finally:
        arm.close()
        mock.close()
