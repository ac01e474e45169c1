"""Listening to the vehicle's own protocol on kernel interfaces: what is refused, and what is heard."""

from __future__ import annotations

import subprocess
import time

import can
import pytest

from drivers.base import CarPhase, LinkOpenError, MonotonicClock
from drivers.charger.car_listener import CarListener, CarSettings
from drivers.charger.kernel_link import read_kernel_link
from tests.socketcan.test_kernel_slcan import KernelAdapter
from tests.unit.test_car_protocols import BCL, BCS, CCS, GIVES, WANTS

FRAMES = {"gbt27930": (True, (*BCS, BCL, CCS)), "chademo": (False, (WANTS, GIVES))}


def test_the_kernel_tells_a_virtual_interface_from_one_that_is_not_there() -> None:
    link = read_kernel_link("vcan0")
    assert (link.is_can, link.is_virtual, link.up, link.listen_only) == (True, True, True, False)
    with pytest.raises(LinkOpenError, match="no CAN interface nocan7"):
        read_kernel_link("nocan7")


def test_a_virtual_interface_is_refused_unless_accepted() -> None:
    with pytest.raises(LinkOpenError, match="not listen-only"):
        CarListener(CarSettings("gbt27930", "vcan0"), MonotonicClock()).open()


@pytest.mark.parametrize("protocol", FRAMES)
def test_the_vehicle_is_heard_and_nothing_is_sent(protocol: str) -> None:
    extended, frames = FRAMES[protocol]
    listener = CarListener(CarSettings(protocol, "vcan0", accept_virtual=True), MonotonicClock())
    listener.open()
    try:
        with can.Bus(interface="socketcan", channel="vcan0", ignore_config=True) as vehicle:
            end_s = time.monotonic() + 20.0
            while listener.status().phase is not CarPhase.CHARGING:
                assert time.monotonic() < end_s, listener.health()
                for identifier, text in frames:
                    data = bytes.fromhex(text)
                    vehicle.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=extended))
                time.sleep(0.05)
            assert vehicle.recv(0.2) is None
    finally:
        listener.close()


def test_a_controller_that_the_kernel_keeps_from_sending_is_taken() -> None:
    try:
        adapter = KernelAdapter("bitrate 250000 listen-only on")
    except subprocess.CalledProcessError as error:
        pytest.skip(f"this kernel's slcan driver cannot only listen: {error.stderr.decode().strip()}")
    try:
        assert read_kernel_link(adapter.name).listen_only
        listener = CarListener(CarSettings("gbt27930", adapter.name), MonotonicClock())
        listener.open()
        listener.close()
    finally:
        adapter.close()
