"""The counter and checksum inside each frame: literal vectors, independent CRCs, and damage that must be noticed."""

from __future__ import annotations

import itertools

import crccheck.crc
import pytest
from cantools.autosar.end_to_end import compute_profile5_crc
from hypothesis import given
from hypothesis import strategies as st

from drivers.charger.e2e import (
    FrameProtection,
    Receiver,
    Scheme,
    Verdict,
    _table,
    classify,
    crc8,
    crc16,
    next_counter,
)

PAYLOAD = bytes.fromhex("00 73 77 3F DE F7 2D 33")
P11 = FrameProtection(Scheme.P11, 0xFF12)


class Crc8StartZero(crccheck.crc.Crc8SaeJ1850):
    _initvalue = 0x00
    _xor_output = 0x00


@pytest.mark.parametrize(
    ("scheme", "sealed"),
    [
        (Scheme.NONE, "00 73 77 3F DE F7 2D 33"),
        (Scheme.COUNTER, "00 73 77 3F DE F7 2D 33"),
        (Scheme.J1850, "F1 73 77 3F DE F7 2D 33"),
        (Scheme.P11, "8D 73 77 3F DE F7 2D 33"),
    ],
)
def test_each_scheme_seals_the_known_frame_as_published(scheme: Scheme, sealed: str) -> None:
    assert FrameProtection(scheme, 0xFF12).seal(PAYLOAD) == bytes.fromhex(sealed)


def test_raw_checksums_have_their_catalogue_check_values() -> None:
    assert crc8(b"123456789", start=0xFF, final_xor=0xFF) == 0x4B
    assert crc8(b"123456789", start=0x00, final_xor=0x00) == 0x37
    assert crc16(b"123456789") == 0x29B1


def test_each_table_holds_the_checksum_of_every_single_byte() -> None:
    """Bit by bit, by an independent implementation; the first entries as they are published."""
    assert list(_table(0x1D, 8)) == [Crc8StartZero.calc(bytes((byte,))) for byte in range(256)]
    assert list(_table(0x1021, 16)) == [crccheck.crc.Crc16Xmodem.calc(bytes((byte,))) for byte in range(256)]
    assert _table(0x1D, 8)[:4] == (0x00, 0x1D, 0x3A, 0x27)
    assert _table(0x1021, 16)[:4] == (0x0000, 0x1021, 0x2042, 0x3063)


@given(st.binary(max_size=64))
def test_checksums_agree_with_an_independent_implementation(data: bytes) -> None:
    assert crc8(data, 0xFF, 0xFF) == crccheck.crc.Crc8SaeJ1850.calc(data)
    assert crc8(data, 0x00, 0x00) == Crc8StartZero.calc(data)
    assert crc16(data) == crccheck.crc.Crc16CcittFalse.calc(data)


@given(st.binary(min_size=3, max_size=64), st.integers(0, 0xFFFF))
def test_the_16_bit_profile_agrees_with_cantools_own(frame: bytes, data_id: int) -> None:
    sealed = FrameProtection(Scheme.P5, data_id).seal(frame)
    assert int.from_bytes(sealed[:2], "little") == compute_profile5_crc(sealed, data_id) or len(frame) < 4


@pytest.mark.parametrize("scheme", [Scheme.J1850, Scheme.P11, Scheme.P5])
def test_a_frame_with_one_or_two_flipped_bits_is_never_intact(scheme: Scheme) -> None:
    protection = FrameProtection(scheme, 0xFF12)
    sealed = int.from_bytes(protection.seal(PAYLOAD), "big")
    for count in (1, 2):
        for bits in itertools.combinations(range(64), count):
            damaged = sealed
            for bit in bits:
                damaged ^= 1 << bit
            assert not protection.intact(damaged.to_bytes(8, "big")), bits


def test_of_three_flipped_bits_fewer_than_one_in_two_hundred_pass_the_checksum() -> None:
    """What an 8-bit checksum cannot do, written down: CAN's own CRC-15 and the counter stand behind it."""
    sealed = int.from_bytes(P11.seal(PAYLOAD), "big")
    masks = [sum(1 << bit for bit in bits) for bits in itertools.combinations(range(64), 3)]
    passed = sum(P11.intact((sealed ^ mask).to_bytes(8, "big")) for mask in masks)
    assert passed == 198
    assert passed < len(masks) / 200


def test_a_burst_within_eight_payload_bits_is_never_intact() -> None:
    sealed = int.from_bytes(P11.seal(PAYLOAD), "big")
    for pattern in range(1, 256):
        for shift in range(56 - pattern.bit_length() + 1):
            assert not P11.intact((sealed ^ pattern << shift).to_bytes(8, "big"))


@given(st.integers(0, 0xFFFF), st.binary(min_size=8, max_size=8))
def test_a_frame_under_another_identity_is_not_intact(other: int, frame: bytes) -> None:
    close = 0xFF12 ^ (1 << other % 16)
    assert not FrameProtection(Scheme.P11, close).intact(P11.seal(frame))


def test_the_checksum_may_stand_anywhere_in_the_frame() -> None:
    protection = FrameProtection(Scheme.P11, 0xFF12, crc_offset=7)
    sealed = protection.seal(bytes(8))
    assert protection.intact(sealed)
    assert sealed[:7] == bytes(7)
    assert sealed[7] == Crc8StartZero.calc(b"\x12\xff" + bytes(7))


@pytest.mark.parametrize(
    ("previous", "counter", "verdict"),
    [
        (None, 0, Verdict.INITIAL),
        (3, 4, Verdict.OK),
        (3, 5, Verdict.OK),
        (14, 0, Verdict.OK),
        (13, 0, Verdict.OK),
        (3, 3, Verdict.REPEATED),
        (3, 6, Verdict.LOST),
        (3, 10, Verdict.LOST),
        (3, 11, Verdict.WRONG_SEQUENCE),
        (3, 2, Verdict.WRONG_SEQUENCE),
        (0, 14, Verdict.WRONG_SEQUENCE),
        (3, 15, Verdict.WRONG_SEQUENCE),
        (None, 15, Verdict.WRONG_SEQUENCE),
    ],
)
def test_counters_are_judged_by_their_step(previous: int | None, counter: int, verdict: Verdict) -> None:
    assert classify(previous, counter, 15) is verdict


def test_counters_run_from_0_to_14_and_never_reach_15() -> None:
    seen, counter = [], 0
    for _ in range(30):
        seen.append(counter)
        counter = next_counter(counter, 15)
    assert seen == [*range(15), *range(15)]


def _frame(counter: int) -> bytes:
    return P11.seal(bytes((0, counter)) + PAYLOAD[2:])


def test_a_receiver_accepts_a_running_counter_and_counts_what_is_missing() -> None:
    receiver = Receiver(P11)
    verdicts = [receiver.check(_frame(c), c) for c in (0, 1, 3, 7, 8)]
    assert verdicts == [Verdict.INITIAL, Verdict.OK, Verdict.OK, Verdict.LOST, Verdict.OK]
    assert receiver.missed == 4


def test_a_repeated_last_frame_is_never_accepted() -> None:
    receiver = Receiver(P11)
    receiver.check(_frame(5), 5)
    receiver.check(_frame(6), 6)
    assert not any(receiver.check(_frame(6), 6).accepted for _ in range(100))


def test_after_a_step_back_the_next_frame_in_order_is_accepted() -> None:
    receiver = Receiver(P11)
    receiver.check(_frame(5), 5)
    assert receiver.check(_frame(4), 4) is Verdict.WRONG_SEQUENCE
    assert receiver.check(_frame(5), 5) is Verdict.OK


def test_a_damaged_frame_moves_nothing() -> None:
    receiver = Receiver(P11)
    receiver.check(_frame(5), 5)
    spoiled = bytes((_frame(6)[0] ^ 1,)) + _frame(6)[1:]
    assert receiver.check(spoiled, 6) is Verdict.BAD_CRC
    assert receiver.check(_frame(6), 6) is Verdict.OK


def test_after_forgetting_the_first_frame_only_sets_the_counter() -> None:
    receiver = Receiver(P11)
    receiver.check(_frame(5), 5)
    receiver.forget()
    assert not receiver.check(_frame(6), 6).accepted
    assert receiver.check(_frame(7), 7).accepted


def test_without_protection_everything_is_accepted() -> None:
    receiver = Receiver(FrameProtection(Scheme.NONE, 0))
    assert all(receiver.check(PAYLOAD, 0) is Verdict.OK for _ in range(3))


def test_with_a_counter_alone_damage_passes_but_repeats_do_not() -> None:
    receiver = Receiver(FrameProtection(Scheme.COUNTER, 0))
    assert receiver.check(b"\xff" * 8, 1) is Verdict.INITIAL
    assert receiver.check(b"\xee" * 8, 2) is Verdict.OK
    assert receiver.check(b"\xdd" * 8, 2) is Verdict.REPEATED


COUNTED = FrameProtection(Scheme.COUNTER, 0)


def counted(*counters: int) -> Receiver:
    """A receiver that has seen frames with these counters, without a checksum."""
    receiver = Receiver(COUNTED)
    for counter in counters:
        receiver.check(PAYLOAD, counter)
    return receiver


def test_every_verdict_is_counted() -> None:
    receiver = counted(0, 1, 2, 2, 2, 2, 6, 5, 15)
    assert receiver.counts == {
        Verdict.INITIAL: 1, Verdict.OK: 2, Verdict.REPEATED: 3, Verdict.LOST: 1, Verdict.WRONG_SEQUENCE: 2,
        Verdict.BAD_CRC: 0,
    }  # fmt: skip


def test_only_frames_that_never_came_are_missed() -> None:
    assert counted(3, 4, 4, 4).missed == 0
    assert counted(3, 5, 4).missed == 1
    assert counted(13, 1).missed == 2


def test_the_invalid_counter_is_not_remembered() -> None:
    receiver = counted(13, 14, 15)
    assert receiver.check(PAYLOAD, 0) is Verdict.OK


def stepping(steps: list[int]) -> Receiver:
    """A receiver that has seen a counter go on by these steps."""
    return counted(*(counter % 15 for counter in itertools.accumulate(steps, initial=0)))


def test_a_sender_that_repeats_its_last_frame_five_times_is_named() -> None:
    assert counted(0, 1, 1, 1, 1, 1).suspicion == ""
    repeating = counted(0, 1, 1, 1, 1, 1, 1)
    assert repeating.suspicion == "it repeats its last frame"
    assert not repeating.two_senders


def test_five_bad_checksums_in_a_row_are_named() -> None:
    receiver = Receiver(P11)
    for frames, suspicion in ((4, ""), (5, "its checksums do not fit")):
        while len(receiver.recent) < frames:
            receiver.check(bytes(8), 1)
        assert receiver.suspicion == suspicion
    assert not receiver.two_senders


def test_two_senders_under_one_identifier_are_told_by_their_counters() -> None:
    two = [counter for k in range(8) for counter in (k, k + 7)]
    assert counted(*two).two_senders
    assert not counted(*two[:15]).two_senders, "sixteen frames are looked at"


@pytest.mark.parametrize("step", [0, 4, 14])
def test_six_of_sixteen_frames_astray_are_two_senders_and_five_are_noise(step: int) -> None:
    """A repeated frame, lost frames and a step back are astray, and only the last sixteen frames count."""
    assert not stepping([step, 1] * 5 + [1] * 6).two_senders
    assert stepping([step, 1] * 6 + [1] * 4).two_senders
    assert not stepping([step, 1] * 6 + [1] * 5 + [1]).two_senders


def test_one_sender_that_loses_single_frames_is_not_suspected() -> None:
    assert stepping([1, 2] * 20).suspicion == ""


def test_the_words_are_those_of_site_files_and_counters_and_each_counter_wraps_where_its_profile_says() -> None:
    assert {scheme.name: (scheme.value, scheme.counter_modulus, scheme.crc_bytes) for scheme in Scheme} == {
        "NONE": ("none", 15, 0),
        "COUNTER": ("counter", 15, 0),
        "J1850": ("j1850", 15, 1),
        "P11": ("e2e-p11", 15, 1),
        "P5": ("e2e-p5", 256, 2),
    }
    assert {verdict.name: verdict.value for verdict in Verdict} == {
        "OK": "ok",
        "LOST": "lost",
        "INITIAL": "initial",
        "REPEATED": "repeated",
        "WRONG_SEQUENCE": "wrong_sequence",
        "BAD_CRC": "bad_crc",
    }
