"""Bus-off, error-passive and a full queue on a real can-dev interface: the kernel's slcan driver on a pty.

The other end of the pty is an adapter made here that drains what the kernel writes, sends status frames, and reports
bus conditions in the kernel driver's own extension of the protocol.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
import subprocess
import threading
import time
import tty
from collections.abc import Iterator

import pytest

from drivers.base import Heartbeat, LinkOpenError, MonotonicClock
from drivers.charger.can_charger import CanCharger
from drivers.charger.car_listener import CarListener, CarSettings
from drivers.charger.settings import CanSettings
from mocks.charger.frames import Frames
from mocks.charger.node import ChargerNode

TIOCSETD, SIOCGIFNAME, N_SLCAN = 0x5423, 0x8910, 17


class KernelAdapter:
    """A tty with the kernel's slcan line discipline, and the adapter behind it."""

    def __init__(self, set_up: str = "bitrate 250000") -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        fcntl.ioctl(self._slave, TIOCSETD, struct.pack("i", N_SLCAN))
        name = fcntl.ioctl(self._slave, SIOCGIFNAME, bytes(32))
        self.name = name.split(b"\x00")[0].decode()
        self.draining, self._closing = True, False
        self.most_bytes = 65536
        """What the bus behind the adapter takes at a time."""
        self._frames, self._node = Frames(None, "e2e-p11"), ChargerNode()
        os.set_blocking(self._master, False)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        self._ip(f"link set {self.name} type can {set_up}")
        self._ip(f"link set {self.name} up")

    @staticmethod
    def _ip(command: str) -> None:
        subprocess.run(["ip", *command.split()], check=True, capture_output=True)

    def report(self, line: bytes) -> None:
        os.write(self._master, line)

    def _serve(self) -> None:
        due_s = 0.0
        while not self._closing:
            if self.draining:
                with contextlib.suppress(OSError):
                    os.read(self._master, self.most_bytes)
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + 0.05
                frame = self._frames.encode("CH_Status", self._node.status())
                with contextlib.suppress(OSError):
                    self.report(f"T{frame.identifier:08X}8{frame.data.hex().upper()}\r".encode())
            time.sleep(0.01)

    def close(self) -> None:
        self._closing = True
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def adapter() -> Iterator[KernelAdapter]:
    adapter = KernelAdapter()
    yield adapter
    adapter.close()


@pytest.fixture
def charger(adapter: KernelAdapter) -> Iterator[CanCharger]:
    settings = CanSettings(
        interface="socketcan", channel=adapter.name, degraded_s=1.0, lost_s=2.0, open_timeout_s=20.0, reopen_max_s=0.5
    )
    charger = CanCharger(settings, MonotonicClock())
    charger.open()
    yield charger
    charger.close()


def _until(charger: CanCharger, words: str, beat: bool = False) -> None:
    end_s = time.monotonic() + 30.0
    while words not in charger.health().detail:
        assert time.monotonic() < end_s, charger.health()
        if beat:
            charger.heartbeat(Heartbeat(2, 3, 1, 1))
        time.sleep(0.02)


def _until_well(charger: CanCharger) -> None:
    end_s = time.monotonic() + 30.0
    while charger.health().detail:
        assert time.monotonic() < end_s, charger.health()
        charger.heartbeat(Heartbeat(2, 3, 1, 1))
        time.sleep(0.02)


def test_error_warning_and_error_passive_are_named(adapter: KernelAdapter, charger: CanCharger) -> None:
    adapter.report(b"sw096000\r")
    _until(charger, "error-warning")
    adapter.report(b"sp000130\r")
    _until(charger, "error-passive")
    assert dict(charger.health().counters)["error_controller_problem"] >= 2


def test_an_error_passive_controller_that_recovers_is_well_again(adapter: KernelAdapter, charger: CanCharger) -> None:
    adapter.report(b"sp000130\r")
    _until(charger, "error-passive")
    adapter.report(b"sa000000\r")
    _until_well(charger)
    assert "reopened" not in dict(charger.health().counters)


def test_after_bus_off_an_adapter_that_is_attached_again_is_heard_again(
    adapter: KernelAdapter, charger: CanCharger
) -> None:
    adapter.report(b"sb000256\r")
    _until(charger, "bus-off")
    adapter.close()
    adapter.__init__()  # type: ignore[misc]  # the kernel's slcan driver cannot restart after bus-off
    _until_well(charger)
    assert dict(charger.health().counters)["reopened"] >= 1


def test_a_full_bus_is_named_and_costs_nothing_once_it_is_free(adapter: KernelAdapter, charger: CanCharger) -> None:
    adapter.most_bytes = 2  # others win every arbitration: a fraction of our frames gets out
    _until(charger, "the bus is full", beat=True)
    adapter.most_bytes = 65536
    _until_well(charger)
    counters = dict(charger.health().counters)
    assert counters["tx_dropped"] > 0
    assert "reopened" not in counters


def test_an_interface_at_another_bit_rate_is_refused_before_it_disturbs_the_bus() -> None:
    adapter = KernelAdapter("bitrate 500000")
    try:
        charger = CanCharger(CanSettings(interface="socketcan", channel=adapter.name), MonotonicClock())
        with pytest.raises(LinkOpenError, match="runs at 500000 bit/s, the configuration says 250000"):
            charger.open()
    finally:
        adapter.close()


def test_a_controller_that_is_not_listen_only_is_refused_for_the_vehicles_protocol(adapter: KernelAdapter) -> None:
    listener = CarListener(CarSettings("gbt27930", adapter.name, accept_virtual=True), MonotonicClock())
    with pytest.raises(LinkOpenError, match="not listen-only"):
        listener.open()


def test_bus_off_is_named(adapter: KernelAdapter, charger: CanCharger) -> None:
    adapter.report(b"sb000256\r")
    _until(charger, "bus-off")
    assert dict(charger.health().counters)["error_bus_off"] == 1


def test_a_bus_that_takes_no_frames_is_told_from_a_full_moment(adapter: KernelAdapter, charger: CanCharger) -> None:
    adapter.draining = False
    _until(charger, "nobody acknowledges", beat=True)
    adapter.draining = True
    _until_well(charger)


def test_bus_errors_are_counted(adapter: KernelAdapter, charger: CanCharger) -> None:
    adapter.report(b"e1a\r")
    end_s = time.monotonic() + 30.0
    while not dict(charger.health().counters).get("error_no_acknowledge"):
        assert time.monotonic() < end_s, charger.health()
        time.sleep(0.02)


def test_an_adapter_that_is_pulled_is_noticed(adapter: KernelAdapter, charger: CanCharger) -> None:
    adapter.close()
    try:
        _until(charger, "adapter is gone", beat=True)
    finally:
        adapter.__init__()  # type: ignore[misc]  # plugged in again, for the fixture to take away
