"""The driver and the mock charger on the kernel's own CAN: a session, an interface that goes down or vanishes."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.base import ChargerRequest, ChargerState, LinkLostError, LinkOpenError, MonotonicClock
from drivers.charger.can_charger import CanCharger
from drivers.charger.e2e import Scheme
from drivers.charger.settings import CanSettings
from tests.contract.charger_bench import Bench, MockProcess

R = ChargerRequest
SLOW_S = 2.0
"""This kernel has one processor and shares it."""
ON_VCAN = ("socketcan", "vcan0")


def _ip(command: str) -> None:
    subprocess.run(["ip", *command.split()], check=True, capture_output=True)


@pytest.fixture
def mock(tmp_path: Path) -> Iterator[MockProcess]:
    mock = MockProcess(tmp_path, f"--lost-ms={1000 * SLOW_S}", "--time-scale=10", on=ON_VCAN)
    yield mock
    mock.stop()


@pytest.fixture
def bench(mock: MockProcess) -> Iterator[Bench]:
    bench = Bench(mock, degraded_s=0.6 * SLOW_S, lost_s=SLOW_S, open_timeout_s=20.0, reopen_max_s=0.5)
    yield bench
    bench.close()


def _lost(bench: Bench) -> bool:
    try:
        bench.charger.status()
    except LinkLostError:
        return True
    return False


def test_a_whole_session(bench: Bench) -> None:
    bench.charge()
    assert bench.charger.status().state is ChargerState.CHARGING
    bench.must(R.STOP_POWER, R.UNLOCK_PLUG)
    counters = dict(bench.charger.health().counters)
    assert counters["bad_checksum"] == counters["losses"] == 0
    assert "foreign_frames" not in counters, "the kernel filters"


def test_an_interface_that_goes_down_and_up_is_heard_again_on_the_same_bus(bench: Bench) -> None:
    bench.welcome()
    _ip("link set vcan0 down")
    bench.until(lambda: "interface is down" in bench.charger.health().detail, 30.0)
    bench.until(lambda: _lost(bench), 30.0)
    _ip("link set vcan0 up")
    bench.until(lambda: not _lost(bench), 30.0)
    assert "reopened" not in dict(bench.charger.health().counters)


def test_an_interface_that_vanishes_is_opened_again_when_it_is_back(bench: Bench, tmp_path: Path) -> None:
    bench.welcome()
    _ip("link del vcan0")
    bench.until(lambda: "adapter is gone" in bench.charger.health().detail, 30.0)
    _ip("link add dev vcan0 type vcan")
    _ip("link set vcan0 mtu 72")
    _ip("link set vcan0 up")
    second = MockProcess(tmp_path, f"--lost-ms={1000 * SLOW_S}", on=ON_VCAN)  # the first one's socket is dead
    try:
        bench.until(lambda: not _lost(bench), 30.0)
        assert dict(bench.charger.health().counters)["reopened"] == 1
    finally:
        second.stop()


def test_an_interface_that_does_not_exist_is_named() -> None:
    charger = CanCharger(CanSettings(interface="socketcan", channel="nocan7"), MonotonicClock())
    with pytest.raises(LinkOpenError, match="no CAN interface nocan7"):
        charger.open()


def test_can_fd(tmp_path: Path) -> None:
    mock = MockProcess(tmp_path, f"--lost-ms={1000 * SLOW_S}", "--protection=e2e-p5", "--fd", on=ON_VCAN)
    bench = Bench(mock, degraded_s=0.6 * SLOW_S, lost_s=SLOW_S, open_timeout_s=20.0, protection=Scheme.P5)
    try:
        bench.welcome()
        bench.must(R.RESERVE)
        assert all(frame.is_fd for frame in bench.log.frames)
    finally:
        bench.close()
        mock.stop()
