"""How quickly the arm is kicked, stopped, opened and checked, and how much of its state arrives, on a busy machine.

Perception-like work runs on every processor at perception's own priority. Latencies are compared with what a bare loop
of 10 ms sleeps suffers in the same run, so that a slow machine does not fail them; both ends of a latency are read
from the host's monotonic clock, the far end by the mock controller when the bytes reach it.
"""

from __future__ import annotations

import bisect
import itertools
import logging
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from controller.sources import Sources
from controller.states import State
from controller.supervisor import Supervisor
from drivers.arm.ur import UrArm
from drivers.base import (
    ArmState,
    ChargerState,
    ChargerStatus,
    Heartbeat,
    LinkHealth,
    MonotonicClock,
    Pilot,
    PlugLock,
    Proximity,
)
from drivers.processor_time import keep_out_of_collections, keep_time
from tests.arm_rig import MockController, settings, until

pytestmark = pytest.mark.benchmark_ratio
log = logging.getLogger(__name__)

ALLOWANCE_S = 0.005
STOP_LINEAR = 33
"""Command id of stopL in ur_rtde's script."""
STOPS = 200
WHILE_MOVING_S = 0.3
"""A stop comes at any moment of this."""
KICK_S = 20.0
RECEPTION_S = 60.0
LOSSES = 10
LOSS_S = 0.1
PATIENT = {"watchdog_hz": 0.5, "patience": 5.0, "freshness_s": 10.0}
"""What is measured here must not end in a fault of the limits that it is about."""
HZ = 500

_LOAD = """
import numpy as np
from drivers.processor_time import give_way
from scipy.spatial import cKDTree
give_way()
rng = np.random.default_rng(1)
while True:
    points = rng.normal(size=(20000, 3))
    _, near = cKDTree(points).query(points[:4000], 8)
    np.linalg.svd(points[near] - points[:4000, None])
"""
_SLEEPER = """
import sys, time
while True:
    due = time.monotonic() + 0.01
    time.sleep(0.01)
    sys.stdout.write(f"{time.monotonic() - due}\\n")
    sys.stdout.flush()
"""


@contextmanager
def perception_like_load() -> Iterator[None]:
    single = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", _LOAD]
    workers = [subprocess.Popen(command, env=single) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()


class BareSleeps:
    """Lateness of a loop of 10 ms sleeps in a process of its own, while this is open."""

    def __enter__(self) -> BareSleeps:
        self._process = subprocess.Popen([sys.executable, "-c", _SLEEPER], stdout=subprocess.PIPE, text=True)
        self.lateness_s: list[float] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        return self

    def _read(self) -> None:
        assert self._process.stdout is not None
        self.lateness_s += [float(line) for line in self._process.stdout if line.endswith("\n")]

    def __exit__(self, *exception: object) -> None:
        self._process.kill()
        self._process.wait()
        self._thread.join(5.0)
        assert self._process.stdout is not None
        self._process.stdout.close()


class TimedArm(UrArm):
    """Notes when each of the supervisor's ticks began: it asks for the state first."""

    ticks: list[float]

    def state(self) -> ArmState:
        if threading.current_thread().name == "supervisor":
            self.ticks.append(time.monotonic())
        return super().state()


class QuietCharger:
    """Always content."""

    def status(self) -> ChargerStatus:
        now_s = time.monotonic()
        ready, absent, pilot, lock = ChargerState.READY, Proximity.ABSENT, Pilot.A, PlugLock.UNLOCKED
        return ChargerStatus(now_s, ready, absent, pilot, lock, False, True, False, False, 0, 0.0, 0.0, now_s)

    def heartbeat(self, beat: Heartbeat) -> None: ...


class QuietScanner:
    """Always there."""

    def health(self) -> LinkHealth:
        return LinkHealth(True, time.monotonic())


class Bench:
    """Mock controller, driver and supervisor at the full rate."""

    def __init__(self) -> None:
        keep_time()  # as whoever assembles a cell does
        self.mock = MockController("--rate", str(HZ))
        self.arm = TimedArm(settings(self.mock.host, frequency_hz=float(HZ), **PATIENT))
        self.arm.ticks = []
        self.arm.open()
        sources = Sources(self.arm, QuietCharger(), QuietScanner())  # type: ignore[arg-type]
        clock = MonotonicClock()
        keep_out_of_collections()
        self.supervisor = Supervisor(sources, clock, clock, stall_s=10.0)
        self.supervisor.enter(State.APPROACHING, None)

    def close(self) -> None:
        self.supervisor.close()
        self.arm.close()
        self.mock.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def p99(values: list[float]) -> float:
    return float(np.quantile(values, 0.99))


def judge(name: str, latencies_s: list[float], sleeps: BareSleeps) -> None:
    allowed_s = p99(sleeps.lateness_s) + ALLOWANCE_S
    log.info(
        "%s: %d times, median %.1f ms, p99 %.1f ms; 10 ms sleep late by p99 %.1f ms; allowed %.1f ms",
        name,
        len(latencies_s),
        1e3 * statistics.median(latencies_s),
        1e3 * p99(latencies_s),
        1e3 * p99(sleeps.lateness_s),
        1e3 * allowed_s,
    )
    assert p99(latencies_s) <= allowed_s


@pytest.mark.parametrize("moving", [False, True])
def test_a_tick_reaches_the_controllers_watchdog_at_once(bench: Bench, moving: bool) -> None:
    arrivals: list[float] = []
    with perception_like_load(), BareSleeps() as sleeps:
        bench.supervisor.start()
        until(lambda: len(bench.arm.ticks) > 100, "the supervisor ticks")
        if moving:
            bench.arm.move_velocity(np.array([0.0, 0.0, 0.002, 0.0, 0.0, 0.0]), 0.1)
        begun = time.monotonic()
        while time.monotonic() < begun + KICK_S:
            time.sleep(1.0)
            arrivals += [kick for kick in bench.mock.do("kicks")["kicks"] if not arrivals or kick > arrivals[-1]]
        ticks = [tick for tick in bench.arm.ticks if begun < tick < arrivals[-1] - 0.5]
    assert len(ticks) > 0.5 * KICK_S * 100
    assert bench.supervisor.trip is None
    judge("tick to kick", [arrivals[bisect.bisect_left(arrivals, tick)] - tick for tick in ticks], sleeps)


def test_a_stop_request_reaches_the_controller_at_once(bench: Bench) -> None:
    latencies: list[float] = []
    rng = np.random.default_rng(6)
    with perception_like_load(), BareSleeps() as sleeps:
        bench.supervisor.start()
        for number in range(STOPS):
            down_m = 0.1 if number // 10 % 2 == 0 else -0.1
            bench.arm.move_linear(bench.arm.state().T_base_tcp.moved([0.0, 0.0, -down_m]), 0.03, 0.5)
            until(lambda: bench.arm.state().moving, "the arm moves")
            time.sleep(rng.uniform(0.0, WHILE_MOVING_S))
            asked = time.monotonic()
            bench.supervisor.request_abort()
            until(lambda: not bench.arm.state().moving, "the arm stands still")
            latencies.append(first_stop(bench, asked) - asked)  # asked only now: answering takes time from the mock
            bench.supervisor.forget_requests()
            bench.supervisor.reset()
    judge("stop request to stop command", latencies, sleeps)


def first_stop(bench: Bench, since_s: float) -> float:
    """When the stop command that was asked for at ``since_s`` reached the mock."""
    found: list[float] = []

    def seen() -> bool:
        found[:] = [
            at for at, number in bench.mock.do("commands")["commands"] if number == STOP_LINEAR and at > since_s
        ]
        return bool(found)

    until(seen, "the stop command arrives")
    return found[0]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP])
def test_a_lost_worker_is_reported_within_a_tenth_of_a_second(number: signal.Signals) -> None:
    mock, times = MockController(), []
    arm = UrArm(settings(mock.host))
    try:
        arm.open()
        with BareSleeps() as sleeps:
            for _ in range(LOSSES):
                os.kill(arm._links.worker.pid, number)
                begun = time.monotonic()
                while arm._links.worker.lost is None:
                    time.sleep(0.001)
                times.append(time.monotonic() - begun)
                arm.recover()
    finally:
        arm.close()
        mock.close()
    log.info("worker lost by %s, reported after %s ms", number.name, ", ".join(f"{1e3 * t:.0f}" for t in sorted(times)))
    assert max(times) < LOSS_S + max(sleeps.lateness_s)


def test_a_minute_of_state_at_full_rate_arrives(bench: Bench) -> None:
    with perception_like_load():
        first = bench.arm.state()
        missed_before = dict(bench.arm.health().counters)["missed"]
        until(
            lambda: bench.arm.state().device_time_s > first.device_time_s + RECEPTION_S,
            "a minute passes",
            RECEPTION_S * 3,
        )
        samples = [state.device_time_s for state in bench.arm.history(first.time_s)]
        missed = dict(bench.arm.health().counters)["missed"] - missed_before
    skips = [(at, seconds) for at, seconds in bench.mock.do("skips")["skips"] if samples[0] <= at < samples[-1]]
    made = (samples[-1] - samples[0] - sum(seconds for _, seconds in skips)) * HZ + 1
    gaps = [(a, b) for a, b in itertools.pairwise(samples) if b - a > 0.020]
    ours = [b - a - sum(seconds for at, seconds in skips if a - 1e-6 <= at < b) for a, b in gaps]
    log.info(
        "%d of %.0f samples (%.3f %%), %d gaps above 20 ms of which the mock made %d, longest of our own %.1f ms; "
        "%d missed in status, %.3f s left out by the mock",
        len(samples),
        made,
        100.0 * len(samples) / made,
        len(gaps),
        sum(gap <= 0.020 for gap in ours),
        1e3 * max(ours, default=0.0),
        missed,
        sum(seconds for _, seconds in skips),
    )
    assert len(samples) >= 0.99 * made
    assert max(ours, default=0.0) <= 0.020
    not_received = round((samples[-1] - samples[0]) * HZ) + 1 - len(samples)
    assert abs(missed - not_received) <= 2  # the counter was read a moment later than the samples


def test_the_arms_link_is_open_within_a_second() -> None:
    mock, times = MockController("--rate", str(HZ)), []
    try:
        for _ in range(7):
            arm = UrArm(settings(mock.host, frequency_hz=float(HZ)))
            times.append(timed(arm.open))
            arm.close()
    finally:
        mock.close()
    log.info("arm link opened in %s s", ", ".join(f"{seconds:.2f}" for seconds in times))
    assert statistics.median(times) < 1.0


def timed(action: Callable[[], object]) -> float:
    begun = time.monotonic()
    action()
    return time.monotonic() - begun
