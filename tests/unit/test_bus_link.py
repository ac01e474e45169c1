"""The kept-open CAN bus: what its reader survives, and what it does not open again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import can
import pytest

from drivers.base import CanFrame, LinkOpenError, MonotonicClock, NullSink
from drivers.charger.bus_link import BusLink
from drivers.charger.settings import CanSettings

SETTINGS = replace(CanSettings("bus-link-test", "virtual"), reopen_first_s=0.01, reopen_max_s=0.02)


def until(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end_s, "never happened"
        time.sleep(0.005)


@pytest.fixture
def sender() -> Iterator[can.BusABC]:
    bus = can.Bus(interface="virtual", channel="bus-link-test")
    yield bus
    bus.shutdown()


def frame(number: int) -> can.Message:
    return can.Message(arbitration_id=number, data=b"x", is_extended_id=True)


def test_a_reader_that_meets_a_defect_opens_the_bus_again_and_goes_on(sender: can.BusABC) -> None:
    heard: list[int] = []

    def receive(message: CanFrame) -> None:
        if message.arbitration_id == 1:
            raise RuntimeError("a defect")
        heard.append(message.arbitration_id)

    link = BusLink(SETTINGS, MonotonicClock(), NullSink(), receive, None)
    link.open()
    try:
        sender.send(frame(1))
        until(lambda: link.counters["reopened"])
        sender.send(frame(2))
        until(lambda: heard == [2])
    finally:
        link.close()


def test_a_bus_that_must_not_be_opened_as_it_is_now_stays_closed_until_it_may(sender: can.BusABC) -> None:
    refused: list[bool] = []
    allowed = False

    def check() -> None:
        if not allowed:
            refused.append(True)
            raise LinkOpenError("not listen-only")

    link = BusLink(SETTINGS, MonotonicClock(), NullSink(), lambda message: None, None, check=check)
    link.open()  # who opens it has checked it
    try:
        link._broken.set()
        until(lambda: len(refused) > 3)
        assert link.counters["reopened"] == 0
        allowed = True
        until(lambda: link.counters["reopened"] == 1)
    finally:
        link.close()


def test_an_error_of_the_operating_system_on_the_way_is_tried_again(
    sender: can.BusABC,
) -> None:
    failures: list[OSError] = []

    def check() -> None:
        if len(failures) < 3:
            failures.append(OSError(11, "resource temporarily unavailable"))
            raise failures[-1]

    link = BusLink(SETTINGS, MonotonicClock(), NullSink(), lambda message: None, None, check=check)
    link.open()
    try:
        link._broken.set()
        until(lambda: link.counters["reopened"] == 1)
        assert len(failures) == 3
    finally:
        link.close()
