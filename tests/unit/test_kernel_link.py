"""What the kernel says of its CAN interfaces, and who is refused because of it."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import Any

import can
import pytest

from controller.car_evidence import Opinion, in_words, opinion
from drivers.base import CarPhase, CarStatus, LinkOpenError, MonotonicClock
from drivers.charger.car_listener import CarListener, CarSettings
from drivers.charger.kernel_link import KernelLink, check_bit_rate, check_listen_only, parse_kernel_link
from tests.unit.test_car_protocols import BCL, BCS, CCS
from tests.unit.test_interlocks import CHARGER


def _answer(**changes: Any) -> str:
    """As iproute2 6.1 prints a real controller."""
    data = {
        "ctrlmode": ["LISTEN-ONLY"],
        "state": "ERROR-ACTIVE",
        "restart_ms": 100,
        "bittiming": {"bitrate": 250000, "sample_point": "0.875"},
    }
    link: dict[str, Any] = {
        "ifname": "can1",
        "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"],
        "link_type": "can",
        "linkinfo": {"info_kind": "can", "info_data": data | changes.pop("data", {})},
    }
    return json.dumps([link | changes])


VCAN = json.dumps(
    [{"ifname": "vcan0", "flags": ["NOARP", "UP"], "link_type": "can", "linkinfo": {"info_kind": "vcan"}}]
)


def test_a_controller_that_only_listens() -> None:
    link = parse_kernel_link(_answer())
    assert link == KernelLink("can1", True, False, True, "ERROR-ACTIVE", 250_000, 100, True)
    check_listen_only(link, accept_virtual=False)
    check_bit_rate(link, 250_000)


SLCAN = """[{"ifindex":3,"ifname":"can0","flags":["NOARP","UP","LOWER_UP"],"mtu":16,"qdisc":"pfifo_fast",
"operstate":"UP","linkmode":"DEFAULT","group":"default","txqlen":10,"link_type":"can","promiscuity":0,"allmulti":0,
"min_mtu":0,"max_mtu":0,"linkinfo":{"info_kind":"can","info_data":{"ctrlmode":["LISTEN-ONLY"],"ctrlmode_supported":[
"LISTEN-ONLY"],"state":"ERROR-ACTIVE","restart_ms":0,"bittiming_bitrate":250000,"bitrate_const":[10000,20000,50000,
100000,125000,250000,500000,800000,1000000],"clock":0}},"num_tx_queues":1,"gso_max_size":65536}]"""


def test_what_iproute2_prints_of_the_kernels_slcan_driver_is_understood() -> None:
    assert parse_kernel_link(SLCAN) == KernelLink("can0", True, False, True, "ERROR-ACTIVE", 250_000, 0, True)


@pytest.mark.parametrize("modes", [[], ["LOOPBACK"], ["BERR-REPORTING", "FD"]])
def test_a_controller_that_may_acknowledge_is_refused(modes: list[str]) -> None:
    link = parse_kernel_link(_answer(data={"ctrlmode": modes}))
    with pytest.raises(LinkOpenError, match="not listen-only") as caught:
        check_listen_only(link, accept_virtual=True)
    assert "listen-only on" in caught.value.remedy


def test_a_virtual_interface_is_taken_only_where_somebody_said_so() -> None:
    link = parse_kernel_link(VCAN)
    assert link.is_virtual
    assert link.bitrate is None
    check_listen_only(link, accept_virtual=True)
    with pytest.raises(LinkOpenError):
        check_listen_only(link, accept_virtual=False)


def test_another_bit_rate_and_an_interface_that_is_down_are_named() -> None:
    with pytest.raises(LinkOpenError, match="runs at 250000 bit/s, the configuration says 500000"):
        check_bit_rate(parse_kernel_link(_answer()), 500_000)
    with pytest.raises(LinkOpenError, match="can1 is down") as caught:
        check_bit_rate(parse_kernel_link(_answer(flags=["NOARP"])), 250_000)
    assert "restart-ms 100" in caught.value.remedy


@pytest.mark.parametrize("text", ["", "[]", "{}", "[1]", '[{"ifname": "x", "linkinfo": []}]'])
def test_an_answer_that_is_not_understood_is_one_line(text: str) -> None:
    with pytest.raises(LinkOpenError, match="not understood"):
        parse_kernel_link(text)


# --- the listener -----------------------------------------------------------------------------------------------------


def _listener(answer: str = VCAN, **settings: Any) -> CarListener:
    values = {"protocol": "gbt27930", "channel": "can1"} | settings
    return CarListener(CarSettings(**values), MonotonicClock(), kernel_link=lambda name: parse_kernel_link(answer))


@pytest.mark.parametrize(
    "listener",
    [
        _listener(_answer(data={"ctrlmode": []})),
        _listener(_answer(data={"bittiming": {"bitrate": 500000}})),
        _listener(VCAN),
        _listener(interface="virtual"),
        _listener(interface="slcan", accept_virtual=True),
    ],
)
def test_nothing_is_opened_that_could_send_or_disturb(monkeypatch: pytest.MonkeyPatch, listener: CarListener) -> None:
    monkeypatch.setattr(can, "Bus", lambda **options: pytest.fail("opened"))
    with pytest.raises(LinkOpenError):
        listener.open()
    listener.close()


def test_the_vehicle_is_heard_on_a_bus_and_nothing_is_ever_sent() -> None:
    listener = _listener(interface="virtual", channel="car-of-this-test", accept_virtual=True)
    listener.open()
    try:
        with can.Bus(interface="virtual", channel="car-of-this-test", ignore_config=True) as vehicle:
            for identifier, text in (*BCS, BCL, CCS):
                vehicle.send(can.Message(arbitration_id=identifier, data=bytes.fromhex(text)))
            _until_charging(listener)
            assert vehicle.recv(0.1) is None
        health = listener.health()
        assert health.up
        assert health.detail == "charging"
        assert dict(health.counters)["messages"] == 3
    finally:
        listener.close()


def _until_charging(listener: CarListener) -> None:
    end_s = time.monotonic() + 5.0
    while listener.status().phase is not CarPhase.CHARGING:
        assert time.monotonic() < end_s, listener.status()
        time.sleep(0.01)


# --- the second opinion -----------------------------------------------------------------------------------------------

FLOWS = {"contactor_closed": True, "current_a": 100.0}


def _car(phase: CarPhase, reason: str = "") -> CarStatus:
    return CarStatus(1.0, "gbt27930", phase, 398.0, 99.0, 100.0, 42.0, reason)


@pytest.mark.parametrize(
    ("charging", "phase", "said"),
    [
        (True, CarPhase.CHARGING, Opinion.CONFIRMED),
        (True, CarPhase.PREPARING, Opinion.CONTRADICTED),
        (True, CarPhase.ENDING, Opinion.CONTRADICTED),
        (True, CarPhase.SILENT, Opinion.NOT_HEARD),
        (False, CarPhase.CHARGING, Opinion.CONTRADICTED),
        (False, CarPhase.PREPARING, Opinion.CONFIRMED),
    ],
)
def test_both_sources_are_compared(charging: bool, phase: CarPhase, said: Opinion) -> None:
    charger = replace(CHARGER, **FLOWS) if charging else CHARGER  # type: ignore[arg-type]
    assert opinion(charger, _car(phase), 2.0) is said


def test_without_a_listener_or_a_charger_there_is_still_an_answer() -> None:
    assert opinion(CHARGER, None, 2.0) is Opinion.NOBODY_LISTENS
    assert opinion(None, _car(CarPhase.CHARGING), 2.0) is Opinion.CONTRADICTED


def test_the_opinion_is_one_line_of_words() -> None:
    words = in_words(Opinion.CONTRADICTED, CHARGER, _car(CarPhase.ENDING, "BST.WantedSoC"))
    assert words == (
        "the charger says 0.0 A; the vehicle says otherwise: gbt27930 ending (BST.WantedSoC), 398 V, 99.0 A, 42 %"
    )
