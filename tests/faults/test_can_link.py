"""The wire itself: nothing there, garbage, an adapter that is pulled and comes back, the wrong bit rate."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.base import ChargerRequest, LinkLostError, LinkOpenError, MonotonicClock
from drivers.charger.can_charger import CanCharger
from drivers.charger.e2e import Scheme
from drivers.charger.settings import CanSettings
from tests.contract.charger_bench import PATIENT, QUICK, Bench, MockProcess


@pytest.fixture(scope="module")
def mock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MockProcess]:
    mock = MockProcess(tmp_path_factory.mktemp("bus"), PATIENT, QUICK)
    yield mock
    assert mock.stop() == 0


@pytest.fixture
def bench(mock: MockProcess) -> Iterator[Bench]:
    bench = Bench(mock.fresh(), reopen_max_s=0.3)
    yield bench
    bench.close()


def _open_error(**settings: object) -> LinkOpenError:
    values = {"open_timeout_s": 0.4, "sleep_after_open_s": 0.02} | settings
    charger = CanCharger(CanSettings(**values), MonotonicClock())  # type: ignore[arg-type]
    with pytest.raises(LinkOpenError) as caught:
        charger.open()
    assert "\n" not in caught.value.cause
    return caught.value


def test_an_adapter_that_is_not_there_is_named(tmp_path: Path) -> None:
    error = _open_error(channel=str(tmp_path / "none"))
    assert "no CAN adapter" in error.cause
    assert "by-id" in error.remedy


def test_a_kernel_without_can_or_an_interface_that_does_not_exist_is_named() -> None:
    error = _open_error(interface="socketcan", channel="nocan7")
    assert "no SocketCAN" in error.cause or "no CAN interface nocan7" in error.cause


def test_an_interface_that_python_can_does_not_know_is_named() -> None:
    error = _open_error(interface="carrier-pigeon", channel="1")
    assert "carrier-pigeon" in error.cause


def test_a_tty_at_which_nobody_answers_is_named() -> None:
    master, slave = os.openpty()
    try:
        error = _open_error(channel=os.ttyname(slave))
        assert "no charger answers" in error.cause
        assert "bit rate" in error.remedy
    finally:
        os.close(master)
        os.close(slave)


def test_the_wrong_bit_rate_hears_no_charger(mock: MockProcess) -> None:
    error = _open_error(channel=str(mock.fresh().link), bitrate=500_000)
    assert "no charger answers" in error.cause
    assert "bit rate" in error.remedy


def test_another_protection_is_told_from_silence(mock: MockProcess) -> None:
    error = _open_error(channel=str(mock.fresh().link), protection=Scheme.J1850)
    assert "checksums do not fit" in error.cause


def test_another_bit_rate_that_the_adapter_does_not_have_is_one_line(mock: MockProcess) -> None:
    error = _open_error(channel=str(mock.fresh().link), bitrate=123_456)
    assert "bit" in error.cause


def test_a_second_process_on_the_same_tty_is_refused_and_does_no_harm(bench: Bench) -> None:
    bench.welcome()
    error = _open_error(channel=str(bench.mock.link))
    assert "taken by another process" in error.cause
    bench.must(ChargerRequest.RESERVE)
    assert dict(bench.charger.health().counters)["losses"] == 0


def test_an_adapter_that_forgot_its_set_up_is_set_up_again(mock: MockProcess) -> None:
    bench = Bench(mock.fresh(), reset_silence_s=0.5, reopen_first_s=0.05)
    try:
        bench.welcome()
        with mock.link.open("wb", buffering=0) as tty:
            tty.write(b"C\r")  # what a reset does: the channel is closed, the tty stays
        bench.until(lambda: dict(bench.charger.health().counters).get("adapter_resets"))
        bench.until(lambda: dict(bench.charger.health().counters).get("reopened"))
        good = dict(bench.charger.health().counters)["ok"]
        bench.until(lambda: dict(bench.charger.health().counters)["ok"] > good + 5)
        bench.until(lambda: not _is_lost(bench))
    finally:
        bench.close()


def test_garbage_on_the_wire_costs_frames_but_not_the_link(bench: Bench) -> None:
    bench.welcome()
    for _ in range(10):
        bench.mock.control(garbage=400)
        good = dict(bench.charger.health().counters)["ok"]
        bench.until(lambda good=good: dict(bench.charger.health().counters)["ok"] > good)
    counters = dict(bench.charger.health().counters)
    assert counters["garbage"] > 0
    assert counters.get("reopened", 0) == 0
    bench.until(lambda: bench.charger.health().up)
    bench.must(ChargerRequest.RESERVE)


def test_an_adapter_that_is_pulled_and_put_back_is_opened_again(bench: Bench) -> None:
    bench.welcome()
    first = os.readlink(bench.mock.link)
    bench.mock.control(unplug_adapter=True)
    bench.until(lambda: _is_lost(bench))
    bench.until(lambda: "adapter is gone" in bench.charger.health().detail)
    with_tick_s = time.monotonic() + 0.5
    bench.until(lambda: time.monotonic() > with_tick_s)  # ticking on without a bus does no harm
    bench.mock.control(unplug_adapter=False)
    bench.until(lambda: not _is_lost(bench))
    counters = dict(bench.charger.health().counters)
    assert counters["reopened"] == 1
    assert counters["tx_dropped"] > 0
    assert os.readlink(bench.mock.link).startswith(first.rsplit("/", 1)[0])
    bench.must(ChargerRequest.RESET_FAULT, ChargerRequest.RESERVE)


def test_closing_while_the_adapter_is_away_ends_both_threads(bench: Bench) -> None:
    bench.welcome()
    bench.mock.control(unplug_adapter=True)
    bench.until(lambda: "adapter is gone" in bench.charger.health().detail)
    threads = bench.charger._link._threads
    bench.charger.close()
    assert not any(thread.is_alive() for thread in threads)
    bench.mock.control(unplug_adapter=False)


def _is_lost(bench: Bench) -> bool:
    try:
        bench.charger.status()
    except LinkLostError:
        return True
    return False
