"""Bus-off, error-passive, a full queue, an interface that goes down: as python-can shows them, on a bus made for it."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator

import can
import pytest

from drivers.base import MonotonicClock
from drivers.charger.bus_errors import Trouble, bus_condition, error_classes, trouble
from drivers.charger.bus_link import BusLink
from drivers.charger.settings import CanSettings
from tests.contract.charger_bench import FrameLog


class RiggedBus:
    """Answers ``recv`` from a queue of messages and exceptions; ``send`` raises what it is told to."""

    def __init__(self) -> None:
        self.arriving: queue.Queue[can.Message | Exception] = queue.Queue()
        self.sent: list[can.Message] = []
        self.refusal: Exception | None = None
        self.is_shut = False

    def recv(self, timeout: float) -> can.Message | None:
        try:
            item = self.arriving.get(timeout=timeout)
        except queue.Empty:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, message: can.Message, timeout: float) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.sent.append(message)

    def shutdown(self) -> None:
        self.is_shut = True


class Rig:
    """A BusLink on rigged buses: each opening takes the next."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.buses: list[RiggedBus] = []
        self.openable = True
        self.received: list[int] = []
        self.log = FrameLog()
        monkeypatch.setattr(can, "Bus", self._open)
        settings = CanSettings(channel="can0", interface="socketcan", reopen_first_s=0.01, reopen_max_s=0.02)
        self.link = BusLink(
            settings, MonotonicClock(), self.log, lambda frame: self.received.append(frame.arbitration_id), []
        )
        self.link.open()

    def _open(self, **options: object) -> RiggedBus:
        if not self.openable:
            raise OSError(19, "No such device")
        self.buses.append(RiggedBus())
        return self.buses[-1]

    @property
    def bus(self) -> RiggedBus:
        return self.buses[-1]

    def send(self, identifier: int = 1) -> None:
        self.link.send([can.Message(arbitration_id=identifier, data=b"\x00")])


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    rig = Rig(monkeypatch)
    yield rig
    rig.link.close()


def _until(condition: Callable[[], object], timeout_s: float = 5.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "never happened"
        time.sleep(0.002)


def _error(identifier: int, data: bytes = bytes(8)) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_error_frame=True, is_extended_id=False)


def _data(identifier: int) -> can.Message:
    return can.Message(arbitration_id=identifier, data=bytes(8))


def test_error_frames_are_counted_by_class_recorded_and_never_decoded(rig: Rig) -> None:
    rig.bus.arriving.put(_error(0x0A8, bytes((0, 0, 0, 0x19, 0, 0, 0, 0))))
    rig.bus.arriving.put(_data(7))
    _until(lambda: rig.received)
    assert rig.received == [7]
    assert rig.link.counters["error_frames"] == 1
    assert rig.link.counters["error_no_acknowledge"] == 1
    assert rig.link.counters["error_bus_error"] == 1
    assert rig.log.frames[0].is_error


def test_bus_off_is_named_until_the_controller_restarts(rig: Rig) -> None:
    rig.bus.arriving.put(_error(0x040))
    _until(lambda: rig.link.trouble == "bus-off")
    rig.bus.arriving.put(_error(0x100))
    _until(lambda: rig.link.trouble == "")


def test_who_hears_a_frame_is_on_the_bus_again(rig: Rig) -> None:
    rig.bus.arriving.put(_error(0x040))
    _until(lambda: rig.link.trouble == "bus-off")
    rig.bus.arriving.put(_data(7))
    _until(lambda: rig.link.trouble == "")


def test_error_passive_and_warning_are_named(rig: Rig) -> None:
    rig.bus.arriving.put(_error(0x204, bytes((0, 0x20, 0, 0, 0, 0, 0x82, 0))))
    _until(lambda: rig.link.trouble == "error-passive")
    rig.bus.arriving.put(_error(0x204, bytes((0, 0x04, 0, 0, 0, 0, 0, 0x60))))
    _until(lambda: rig.link.trouble == "error-warning")


def test_a_queue_that_is_full_for_a_moment_only_drops(rig: Rig) -> None:
    rig.bus.refusal = can.CanOperationError("full", 105)
    rig.send()
    _until(lambda: rig.link.counters["tx_dropped"] == 1)
    assert rig.link.trouble == ""
    rig.bus.refusal = None
    rig.send()
    _until(lambda: rig.bus.sent)


def test_a_queue_that_stays_full_is_a_bus_that_nobody_acknowledges(rig: Rig) -> None:
    rig.bus.refusal = can.CanOperationError("full", 105)

    def complained() -> bool:
        rig.send()
        return "acknowledges" in rig.link.trouble

    _until(complained)
    rig.bus.refusal = None

    def well() -> bool:
        rig.send()
        return rig.link.trouble == ""

    _until(well)
    assert len(rig.buses) == 1


def test_a_full_bus_is_named_although_a_frame_slips_through_now_and_then(rig: Rig) -> None:
    full, count = can.CanOperationError("full", 105), 0
    original = rig.bus.send

    def now_and_then(message: can.Message, timeout: float) -> None:
        nonlocal count
        count += 1
        if count % 7:
            raise full
        original(message, timeout)

    rig.bus.send = now_and_then  # type: ignore[method-assign]

    def complained() -> bool:
        rig.send()
        return "the bus is full" in rig.link.trouble

    _until(complained)
    slipped = len(rig.bus.sent)
    _until(lambda: rig.send() or len(rig.bus.sent) > slipped + 3)
    assert "the bus is full" in rig.link.trouble


def test_an_interface_that_goes_down_and_up_needs_no_new_bus(rig: Rig) -> None:
    rig.bus.arriving.put(can.CanOperationError("Network is down", 100))
    _until(lambda: "interface is down" in rig.link.trouble)
    rig.bus.arriving.put(_data(9))
    _until(lambda: rig.link.trouble == "")
    assert len(rig.buses) == 1


def test_an_interface_that_is_gone_is_opened_again_when_it_is_back(rig: Rig) -> None:
    rig.openable = False
    gone = rig.bus
    gone.arriving.put(can.CanOperationError("No such device", 19))
    _until(lambda: gone.is_shut)
    assert "gone" in rig.link.trouble
    rig.send()
    _until(lambda: rig.link.counters["tx_dropped"] == 1)
    rig.openable = True
    _until(lambda: len(rig.buses) == 2 and rig.link.trouble == "")
    rig.bus.arriving.put(_data(5))
    _until(lambda: rig.received == [5])
    rig.send()
    _until(lambda: rig.bus.sent)


def test_a_send_that_finds_no_device_opens_the_bus_again(rig: Rig) -> None:
    rig.bus.refusal = can.CanOperationError("No such device or address", 6)
    rig.send()
    _until(lambda: len(rig.buses) == 2)


@pytest.mark.parametrize("error", [ValueError("invalid literal"), IndexError("index"), KeyError("x"), TypeError("y")])
def test_what_the_adapters_parser_chokes_on_is_counted_and_skipped(rig: Rig, error: Exception) -> None:
    rig.bus.arriving.put(error)
    rig.bus.arriving.put(_data(3))
    _until(lambda: rig.received == [3])
    assert rig.link.counters["garbage"] == 1


def test_a_bus_that_takes_nothing_never_holds_the_caller_up_and_keeps_only_the_newest(rig: Rig) -> None:
    held = rig.bus
    release = queue.Queue[None]()
    original = held.send

    def stuck(message: can.Message, timeout: float) -> None:
        release.get()
        original(message, timeout)

    held.send = stuck  # type: ignore[method-assign]
    rig.send(1)
    _until(lambda: not rig.link._mail)
    for number in range(5):
        rig.link.send([can.Message(arbitration_id=2, data=bytes((number,)))])
    assert rig.link.counters["tx_replaced"] == 4
    release.put(None)
    release.put(None)
    _until(lambda: len(held.sent) == 2)
    assert held.sent[1].data == b"\x04"


def test_classes_and_conditions_follow_the_kernels_header() -> None:
    assert error_classes(0x08C) == ["controller_problem", "protocol_violation", "bus_error"]
    assert bus_condition(0x040, bytes(8), "") == "bus-off"
    assert bus_condition(0x004, bytes((0, 0x40)), "error-passive") == ""
    assert bus_condition(0x008, bytes(8), "error-warning") == "error-warning"


def test_exceptions_are_told_apart_by_their_number() -> None:
    assert trouble(can.CanOperationError("x", 105)) is Trouble.FULL
    assert trouble(can.CanOperationError("x", 100)) is Trouble.DOWN
    assert trouble(can.CanOperationError("x", 19)) is Trouble.BROKEN
    assert trouble(OSError(5, "Input/output error")) is Trouble.BROKEN
