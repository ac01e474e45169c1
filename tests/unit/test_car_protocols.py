"""The vehicle's own protocols, listened to: literal frames in, what the vehicle says out; long messages joined."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import CarPhase
from drivers.charger.car_chademo import Chademo
from drivers.charger.car_gbt27930 import Gbt27930
from drivers.charger.car_transport import Identifier, Transport

BCL = (0x181056F4, "A0 0F B8 0B 02")  # 400 V, 100 A, constant current
CCS = (0x1812F456, "91 0F BD 0B 0C 00 FD FF")  # 398.5 V, 99.5 A, 12 min, permitted
CCS_PAUSED = (0x1812F456, "91 0F BD 0B 0C 00 FC FF")
BCS = (  # 398 V, 99 A, 3.65 V in group 3, 42 %, 35 min: nine bytes by request, clearance, two packets, acknowledgement
    (0x1CEC56F4, "10 09 00 02 FF 00 11 00"),
    (0x1CECF456, "11 02 01 FF FF 00 11 00"),
    (0x1CEB56F4, "01 8C 0F C2 0B 6D 31 2A"),
    (0x1CEB56F4, "02 23 00 FF FF FF FF FF"),
    (0x1CECF456, "13 09 00 02 FF 00 11 00"),
)
BST = (0x101956F4, "01 00 00 00")  # wanted state of charge reached
CST = (0x101AF456, "04 00 00 00")  # stopped by hand


class Ear:
    """A decoder with a clock."""

    def __init__(self, decoder: Gbt27930 | Chademo, extended: bool) -> None:
        self.decoder, self.extended, self.now_s = decoder, extended, 10.0

    def hear(self, *frames: tuple[int, str], after_s: float = 0.01) -> None:
        for identifier, text in frames:
            self.now_s += after_s
            self.decoder.take(identifier, self.extended, bytes.fromhex(text), self.now_s)

    @property
    def phase(self) -> CarPhase:
        return self.decoder.status(self.now_s).phase


@pytest.fixture
def gbt() -> Ear:
    return Ear(Gbt27930(), extended=True)


@pytest.fixture
def chademo() -> Ear:
    return Ear(Chademo(), extended=False)


# --- GB/T 27930-2015 ------------------------------------------------------------------------------------------------


def test_gbt_a_vehicle_that_wants_and_measures_current_is_charging(gbt: Ear) -> None:
    gbt.hear(*BCS, BCL, CCS)
    status = gbt.decoder.status(gbt.now_s)
    assert status.phase is CarPhase.CHARGING
    assert (status.voltage_v, status.current_a, status.charge_percent) == pytest.approx((398.0, 99.0, 42.0))
    assert status.wanted_current_a == pytest.approx(100.0)
    assert status.protocol == "gbt27930"


@pytest.mark.parametrize("frames", [(BCL, CCS), (*BCS, CCS), (*BCS, BCL), (*BCS, BCL, CCS_PAUSED)])
def test_gbt_what_lacks_wish_measurement_or_permission_is_not_charging(
    gbt: Ear, frames: tuple[tuple[int, str]]
) -> None:
    gbt.hear(*frames)
    assert gbt.phase is CarPhase.PREPARING


def test_gbt_without_current_it_is_not_charging(gbt: Ear) -> None:
    packets = (BCS[0], BCS[1], (0x1CEB56F4, "01 8C 0F A0 0F 6D 31 2A"), BCS[3])  # raw 4000: 0 A
    gbt.hear(*packets, BCL, CCS)
    assert gbt.decoder.status(gbt.now_s).current_a == pytest.approx(0.0)
    assert gbt.phase is CarPhase.PREPARING


@pytest.mark.parametrize(("end", "reason"), [(BST, "BST.WantedSoC"), (CST, "CST.Manual")])
def test_gbt_either_side_may_end_it_and_says_why(gbt: Ear, end: tuple[int, str], reason: str) -> None:
    gbt.hear(*BCS, BCL, CCS, end)
    assert gbt.phase is CarPhase.ENDING
    assert gbt.decoder.status(gbt.now_s).reason == reason


def test_gbt_wishes_grow_old_after_a_second_and_everything_after_five(gbt: Ear) -> None:
    gbt.hear(*BCS, BCL, CCS)
    gbt.now_s += 1.1
    assert gbt.phase is CarPhase.PREPARING
    assert math.isnan(gbt.decoder.status(gbt.now_s).wanted_current_a)
    gbt.now_s += 4.0
    assert gbt.phase is CarPhase.SILENT
    assert math.isnan(gbt.decoder.status(gbt.now_s).voltage_v)


def test_gbt_nothing_heard_is_silence() -> None:
    assert Gbt27930().status(5.0).phase is CarPhase.SILENT


def test_gbt_foreign_nodes_and_short_frames_are_counted_and_say_nothing(gbt: Ear) -> None:
    gbt.hear((0x18105633, BCL[1]), (0x0CFF2056, "00 " * 8), (0x181056F4, ""))
    gbt.decoder.take(0x102, False, bytes(8), gbt.now_s)
    counters = gbt.decoder.counters
    assert (counters["foreign_frames"], counters["bad_frames"], counters["messages"]) == (3, 1, 0)


def test_gbt_the_handshake_is_named_by_its_identifiers() -> None:
    known = {message.name: message.frame_id for message in Gbt27930()._newest.database.messages}
    assert known["CRM"] == 0x1801F456
    assert known["CHM"] == 0x1826F456
    assert known["BEM"] == 0x081E56F4


# --- transport protocol -----------------------------------------------------------------------------------------------


def _announced(data: bytes, control: int = 32) -> list[bytes]:
    """The frames that carry ``data`` as PGN 0x1100."""
    packets = -(-len(data) // 7)
    head = bytes((control, len(data) & 0xFF, len(data) >> 8, packets, 0xFF, 0x00, 0x11, 0x00))
    padded = data.ljust(7 * packets, b"\xff")
    return [head, *(bytes((k + 1,)) + padded[7 * k : 7 * k + 7] for k in range(packets))]


def _through(frames: list[bytes], step_s: float = 0.05) -> list[tuple[int, bytes]]:
    transport, ends = Transport(), []
    for k, frame in enumerate(frames):
        pgn = 0xEC00 if k == 0 else 0xEB00
        if (end := transport.take(Identifier(pgn, 0xF4, 0xFF), frame, step_s * k)) is not None:
            ends.append(end)
    return ends


@given(st.binary(min_size=9, max_size=1785), st.sampled_from([16, 32]))
def test_any_long_message_comes_out_as_it_went_in(data: bytes, control: int) -> None:
    assert _through(_announced(data, control)) == [(0x1100, data)]


@given(st.binary(min_size=15, max_size=200), st.data())
def test_a_lost_or_doubled_packet_loses_the_message_and_never_makes_another(data: bytes, draw: st.DataObject) -> None:
    frames = _announced(data)
    hit = draw.draw(st.integers(1, len(frames) - 2))
    assert _through(frames[:hit] + frames[hit + 1 :]) == []
    assert _through(frames[: hit + 1] + frames[hit:]) == []


@given(st.lists(st.tuples(st.sampled_from([0xEC00, 0xEB00]), st.binary(max_size=9)), max_size=60))
def test_whatever_comes_harms_nothing(frames: list[tuple[int, bytes]]) -> None:
    transport = Transport()
    for k, (pgn, data) in enumerate(frames):
        end = transport.take(Identifier(pgn, 0xF4, 0x56), data, 0.01 * k)
        assert end is None or 8 < len(end[1]) <= 1785


def test_packets_that_come_too_late_are_no_message() -> None:
    assert _through(_announced(bytes(20)), step_s=1.3) == []


def test_an_abort_by_the_receiver_ends_a_message() -> None:
    transport, frames = Transport(), _announced(bytes(14), control=16)
    transport.take(Identifier(0xEC00, 0xF4, 0x56), frames[0], 0.0)
    transport.take(Identifier(0xEC00, 0x56, 0xF4), bytes((255, 1, 255, 255, 255, 0, 0x11, 0)), 0.1)
    assert transport.take(Identifier(0xEB00, 0xF4, 0x56), frames[1], 0.2) is None
    assert transport.counters["stray_packets"] == 1


def test_packets_that_the_receiver_asks_for_again_are_taken_again() -> None:
    transport, data = Transport(), bytes(range(21))
    frames = _announced(data, control=16)
    to, back = Identifier(0xEB00, 0xF4, 0x56), Identifier(0xEC00, 0x56, 0xF4)
    transport.take(Identifier(0xEC00, 0xF4, 0x56), frames[0], 0.0)
    for frame in frames[1:3]:
        assert transport.take(to, frame, 0.1) is None
    transport.take(back, bytes((17, 2, 2, 255, 255, 0, 0x11, 0)), 0.2)
    assert transport.take(to, frames[2], 0.3) is None
    assert transport.take(to, frames[3], 0.4) == (0x1100, data)


def test_identifiers_are_taken_apart_by_their_format() -> None:
    assert Identifier.of(0x1CEC56F4) == Identifier(0xEC00, 0xF4, 0x56)
    assert Identifier.of(0x0CFF10B0) == Identifier(0xFF10, 0xB0, 0xFF)


# --- CHAdeMO ----------------------------------------------------------------------------------------------------------

WANTS = (0x102, "02 9A 01 78 00 01 37 00")  # 410 V, 120 A, enabled, contactor closed, 55 %
GIVES = (0x109, "02 8C 01 76 00 05 FF 1E")  # 396 V, 118 A, charging, plug locked


def test_chademo_a_vehicle_that_wants_current_and_gets_it_is_charging(chademo: Ear) -> None:
    chademo.hear(WANTS, GIVES)
    status = chademo.decoder.status(chademo.now_s)
    assert status.phase is CarPhase.CHARGING
    assert (status.voltage_v, status.current_a, status.wanted_current_a, status.charge_percent) == (396, 118, 120, 55)


@pytest.mark.parametrize(
    ("frames", "phase"),
    [
        ((), CarPhase.SILENT),
        ((GIVES,), CarPhase.SILENT),
        ((WANTS,), CarPhase.PREPARING),
        (((0x102, "02 9A 01 78 00 00 37 00"), GIVES), CarPhase.PREPARING),  # not enabled
        (((0x102, "02 9A 01 78 00 09 37 00"), GIVES), CarPhase.PREPARING),  # contactor open
        (((0x102, "02 9A 01 00 00 01 37 00"), GIVES), CarPhase.PREPARING),  # wants nothing
        ((WANTS, (0x109, "02 8C 01 00 00 05 FF 1E")), CarPhase.PREPARING),  # gets nothing
        (((0x102, "02 9A 01 78 00 11 37 00"), GIVES), CarPhase.ENDING),  # asks to stop
        (((0x102, "02 9A 01 78 08 01 37 00"), GIVES), CarPhase.ENDING),  # too hot
    ],
)
def test_chademo_everything_else_is_not_charging(chademo: Ear, frames: tuple[tuple[int, str]], phase: CarPhase) -> None:
    chademo.hear(*frames)
    assert chademo.phase is phase


def test_chademo_says_why_it_ends(chademo: Ear) -> None:
    chademo.hear((0x102, "02 9A 01 78 08 11 37 00"))
    assert chademo.decoder.status(chademo.now_s).reason == "StopRequest, HighTemperature"


def test_chademo_grows_old_after_a_second(chademo: Ear) -> None:
    chademo.hear(WANTS, GIVES)
    chademo.now_s += 1.1
    assert chademo.phase is CarPhase.SILENT


def test_chademo_frames_of_another_length_or_kind_are_counted(chademo: Ear) -> None:
    chademo.hear((0x102, "02 9A 01"), (0x123, "00"))
    chademo.decoder.take(0x102, True, bytes(8), chademo.now_s)
    assert chademo.decoder.counters == {"bad_frames": 1, "foreign_frames": 2}
