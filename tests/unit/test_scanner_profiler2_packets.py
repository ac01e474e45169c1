"""Packets of the Profiler 2 against the bytes printed in manual 8017035, on both sides of the line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.scanner.profiler2_codec import PacketReader, block_check, encode, read_request
from mocks.scanner import profiler2 as device

ADDRESS_QUESTION = bytes.fromhex("02 00 40 0B 03 4B")
ADDRESS_ANSWER = bytes.fromhex("02 02 40 0B 03 06 20 00 03 6C")
SIZE_QUESTION = bytes.fromhex("02 03 00 02 03 06 20 00 01 11 03 34")
POINTS_QUESTION = bytes.fromhex("02 03 00 02 03 06 20 04 7E 21 03 7F")
MEASURED_QUESTION = bytes.fromhex("02 01 A0 17 00 00 03 B6")
# size 6800 (832 points): LEN 3, address, one word
SIZE_ANSWER = bytes.fromhex("02 03 00 02 03 06 20 00 68 00 03 4C")


def test_questions_are_the_manuals_bytes() -> None:
    assert encode(0x400B) == ADDRESS_QUESTION
    assert read_request(0x03062000, 1) == SIZE_QUESTION
    assert read_request(0x03062004, 126, pairs=True) == POINTS_QUESTION
    assert encode(0xA017, [0]) == MEASURED_QUESTION


def test_thinning_is_the_low_digit_of_the_request() -> None:
    assert read_request(0x03062004, 126, pairs=True, step=15)[4:10] == bytes.fromhex("03 06 20 04 7E 2F")


def test_answers_are_read_from_the_manuals_bytes() -> None:
    address, size = PacketReader().feed(ADDRESS_ANSWER + SIZE_ANSWER)
    assert (address.command, address.words.tolist()) == (0x400B, [0x0306, 0x2000])
    assert (size.command, size.words.tolist()) == (0x0002, [0x0306, 0x2000, 0x6800])


def test_a_wrong_block_check_is_dropped_or_tolerated_and_counted() -> None:
    spoiled = SIZE_ANSWER[:-1] + b"\x00"
    strict, tolerant = PacketReader(), PacketReader(tolerant=True)
    assert strict.feed(spoiled + ADDRESS_ANSWER)[0].command == 0x400B
    assert strict.counters.bad_checksum == 1
    assert tolerant.feed(spoiled)[0].words[-1] == 0x6800
    assert tolerant.counters.tolerated == 1


def test_a_length_one_word_off_is_tolerated_where_that_is_asked_for() -> None:
    """The manual's size reply: two data words follow the address, LEN and BCC are those of one."""
    printed = bytes.fromhex("02 03 00 02 03 06 20 00 68 00 12 34 03")
    body = printed[1:-1]
    printed += bytes([int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))])
    assert PacketReader().feed(printed) == []
    (packet,) = PacketReader(tolerant=True).feed(printed)
    assert packet.words.tolist() == [0x0306, 0x2000, 0x6800, 0x1234]


def test_start_and_end_bytes_inside_the_data_are_data() -> None:
    inside = encode(0x0002, [0x0203, 0x0302, 0x0202, 0x0303])
    (packet,) = PacketReader().feed(inside)
    assert packet.words.tolist() == [0x0203, 0x0302, 0x0202, 0x0303]


EDIT = st.tuples(st.sampled_from(["delete", "double", "flip"]), st.integers(0, 10**6), st.integers(0, 7))


def counts(reader: PacketReader) -> dict[str, int]:
    return dict(reader.counters.as_pairs())


def test_what_comes_and_what_is_dropped_is_counted() -> None:
    reader = PacketReader()
    wrong_end = bytes.fromhex("02 00 40 0B 04 4B")
    wrong_check = bytes.fromhex("02 00 40 0B 03 4C")
    stream = b"\x00\x01\xff" + SIZE_QUESTION + wrong_end + ADDRESS_ANSWER + wrong_check + b"\x05" + ADDRESS_QUESTION
    assert [packet.command for packet in reader.feed(stream)] == [0x0002, 0x400B, 0x400B]
    assert counts(reader) == {"bytes": 44, "packets": 3, "bytes_dropped": 16, "bad_checksum": 1, "tolerated": 0}
    assert reader.feed(ADDRESS_ANSWER[:7]) == []
    reader.flush()
    assert counts(reader)["bytes_dropped"] == 23
    assert [packet.command for packet in reader.feed(ADDRESS_ANSWER)] == [0x400B], "the unfinished one is forgotten"
    assert counts(reader)["packets"] == 4


@pytest.mark.parametrize("tolerant", [False, True])
def test_a_packet_is_found_with_its_last_byte_and_not_before(tolerant: bool) -> None:
    for packet in (ADDRESS_QUESTION, SIZE_ANSWER):
        reader = PacketReader(tolerant)
        assert [len(reader.feed(packet[k : k + 1])) for k in range(len(packet))] == [0] * (len(packet) - 1) + [1]
        assert counts(reader)["bytes_dropped"] == 0
        assert counts(reader)["tolerated"] == 0


ONE_WORD_LESS = bytes.fromhex("02 03 40 0B 03 06 20 00 03 6D")
"""LEN says three words, two follow; 6D is 03 ^ 40 ^ 0B ^ 03 ^ 06 ^ 20 ^ 00."""


def test_a_length_one_word_too_long_is_tolerated_only_with_a_right_check() -> None:
    tolerant = PacketReader(tolerant=True)
    (packet,) = tolerant.feed(ONE_WORD_LESS)
    assert packet.words.tolist() == [0x0306, 0x2000]
    assert counts(tolerant) == {"bytes": 10, "packets": 1, "bytes_dropped": 0, "bad_checksum": 0, "tolerated": 1}
    spoiled = PacketReader(tolerant=True)
    (packet,) = spoiled.feed(ONE_WORD_LESS[:-1] + b"\x6c" + ADDRESS_QUESTION)
    assert packet.words.tolist() == []
    assert counts(spoiled) == {"bytes": 16, "packets": 1, "bytes_dropped": 10, "bad_checksum": 0, "tolerated": 0}


def test_a_packet_that_does_not_end_where_it_should_is_never_tolerated() -> None:
    reader = PacketReader(tolerant=True)
    assert reader.feed(bytes.fromhex("02 00 40 0B 04 4B") + bytes(2)) == []
    assert counts(reader) == {"bytes": 8, "packets": 0, "bytes_dropped": 8, "bad_checksum": 0, "tolerated": 0}


def test_the_check_of_nothing_is_zero_and_of_one_byte_itself() -> None:
    assert [block_check(body) for body in (b"", b"\xa5", b"\xa5\x5a", b"\xff\xff\x01")] == [0, 0xA5, 0xFF, 0x01]


def test_a_read_of_single_words_and_one_of_pairs_differ_in_one_digit() -> None:
    assert read_request(0x12345678, 5)[4:10] == bytes.fromhex("12 34 56 78 05 11")
    assert read_request(0x12345678, 5, pairs=True, step=2)[4:10] == bytes.fromhex("12 34 56 78 05 22")


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=12), st.integers(1, 30))
def test_packets_behind_garbage_are_found_however_they_are_cut(garbage: bytes, size: int) -> None:
    stream = garbage.replace(b"\x02", b"\x00") + ADDRESS_ANSWER + SIZE_ANSWER + ADDRESS_ANSWER
    reader = PacketReader()
    packets = []
    for start in range(0, len(stream), size):
        packets += reader.feed(stream[start : start + size])
    assert [packet.command for packet in packets] == [0x400B, 0x0002, 0x400B]


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_are_taken_without_an_error(data: bytes, tolerant: bool) -> None:
    reader = PacketReader(tolerant)
    reader.feed(data)
    assert len(reader._rest) <= 6 + 2 * 256


# --- the mock's side ------------------------------------------------------------------------------------------------


class Wire:
    idle = True

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def send(self, data: bytes, not_before_s: float) -> None:
        self.sent.append(data)


class Clock:
    scale = 1.0

    def __init__(self) -> None:
        self.time_s = 10.0

    def now_s(self) -> float:
        return self.time_s


class Ramp:
    def begin_sweep(self) -> None: ...

    def lines(self, first: int, times_s: list[float]) -> list[np.ndarray]:  # type: ignore[type-arg]
        x = np.linspace(-0.015, 0.015, 832)
        return [np.stack([x, 0.1 + x / 2], axis=1) for _ in times_s]


def answers(*questions: bytes) -> list[bytes]:
    wire, clock = Wire(), Clock()
    mock = device.Profiler2Device(Ramp(), wire, clock)  # type: ignore[arg-type]
    for question in questions:
        mock.receive(question)
    return wire.sent


def test_the_mock_answers_the_manuals_questions_with_its_bytes() -> None:
    address, size, points = answers(ADDRESS_QUESTION, SIZE_QUESTION, POINTS_QUESTION)
    assert address == ADDRESS_ANSWER
    assert size == SIZE_ANSWER
    assert points[:8] == bytes.fromhex("02 FE 00 02 03 06 20 04")
    assert len(points) == 6 + 2 * 254
    first = np.frombuffer(points, ">i2", 4, 8).tolist()
    assert first == [-15000, 7500, -14964, 7482]  # micrometres; Y grows towards the device


@pytest.mark.parametrize(
    ("question", "error"),
    [
        ("02 00 12 34 03 26", 0xE001),
        ("02 03 00 02 03 06 20 00 01 11 03 35", 0xE004),
        ("02 00 40 0B 04 4B", 0xE005),
        ("02 03 00 02 03 06 1F 00 01 11 03 0B", 0xE002),  # below the profile
        ("02 03 00 02 03 06 20 04 7F 21 03 7E", 0xE002),  # 127 points do not fit a packet
    ],
)
def test_the_mock_answers_wrong_questions_with_the_devices_error(question: str, error: int) -> None:
    (answer,) = answers(bytes.fromhex(question))
    assert answer[1:4] == b"\x00" + error.to_bytes(2, "big")


def test_the_mock_forgets_a_question_that_takes_longer_than_two_seconds() -> None:
    wire, clock = Wire(), Clock()
    mock = device.Profiler2Device(Ramp(), wire, clock)  # type: ignore[arg-type]
    mock.receive(ADDRESS_QUESTION[:3])
    clock.time_s += 2.1
    mock.collect()
    assert wire.sent[-1][2:4] == b"\xe0\x03"
    mock.receive(ADDRESS_QUESTION)
    assert wire.sent[-1] == ADDRESS_ANSWER
