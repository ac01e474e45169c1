"""SCIP 2 against the examples of its specification, on both sides of the line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.scanner.scip import geometry_of
from drivers.scanner.scip_codec import Reply, ReplyReader, decode, is_sound, parameters
from mocks.scanner.scip import ScipDevice, encode

# C-42-03320B, section on encoding
EXAMPLES = [(2, 1234, b"CB"), (3, 5432, b"1Dh"), (4, 16000000, b"m2@0")]


@pytest.mark.parametrize(("characters", "number", "text"), EXAMPLES)
def test_numbers_are_coded_as_in_the_specification(characters: int, number: int, text: bytes) -> None:
    decoded = decode((text,), characters)
    assert decoded is not None
    assert decoded.tolist() == [number]
    assert encode(np.array([number]), characters)[:-2] == text


def test_the_sums_of_the_usual_status_lines() -> None:
    assert is_sound(b"00P")
    assert is_sound(b"99b")
    assert is_sound(b"10Q")
    assert not is_sound(b"00Q")
    assert is_sound(b"DMIN:20;4")  # the sum leaves out the semicolon
    assert is_sound(b"DMIN:20;" + bytes([(sum(b"DMIN:20;") & 0x3F) + 0x30]))  # or does not


@pytest.mark.parametrize("characters", [2, 3, 4])
def test_numbers_that_straddle_lines_come_out_whole(characters: int) -> None:
    values = np.arange(100) * 37 % 4096
    lines = encode(values, characters).split(b"\n")[:-1]
    assert all(len(line) == 65 for line in lines[:-1])
    decoded = decode(tuple(line[:-1] for line in lines), characters)
    assert decoded is not None
    assert decoded.tolist() == values.tolist()


def test_a_reply_is_echo_status_and_lines() -> None:
    (reply,) = ReplyReader().feed(b"PP\n00P\nDMIN:20;4\nARES:1024;\\\n\n")
    assert reply == Reply("PP", "00", (b"DMIN:20;", b"ARES:1024;"))
    assert parameters(reply) == (("DMIN", "20"), ("ARES", "1024"))


def test_a_parameter_that_is_missing_is_named() -> None:
    with pytest.raises(Exception, match="DMAX"):
        geometry_of(Reply("PP", "00", (b"DMIN:20;",)))


SCAN = b"MD0044072501000\n99b\n" + encode(np.array([123456]), 4) + encode(np.arange(682), 3) + b"\n"


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 80))
def test_replies_are_found_however_they_are_cut(size: int) -> None:
    stream = b"\n" + SCAN + b"QT\n00P\n\n" + SCAN
    reader, replies = ReplyReader(), []
    for start in range(0, len(stream), size):
        replies += reader.feed(stream[start : start + size])
    assert [reply.status for reply in replies] == ["99", "00", "99"]
    assert reader.counters.bad_checksum == 0


@settings(max_examples=500, deadline=None)
@given(st.integers(0, 8 * len(SCAN) - 1))
def test_one_flipped_bit_never_gives_a_wrong_scan(bit: int) -> None:
    spoiled = bytearray(SCAN)
    spoiled[bit // 8] ^= 1 << bit % 8
    for reply in ReplyReader().feed(bytes(spoiled) + b"\n\n" + SCAN):
        values = decode(reply.lines[1:], 3)
        if reply.status == "99" and reply.echo[:2] == "MD" and values is not None and len(values) == 682:
            assert values.tolist() == list(range(682))


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_taken_without_an_error(data: bytes) -> None:
    reader = ReplyReader()
    for reply in reader.feed(data + b"\n\n"):
        decode(reply.lines, 3)
        parameters(reply)


# --- the mock's side ------------------------------------------------------------------------------------------------


class Wire:
    def __init__(self) -> None:
        self.sent = b""

    def send(self, data: bytes, not_before_s: float) -> None:
        self.sent += data

    def backlog_s(self, now_s: float) -> float:
        return 0.0


class Clock:
    time_s = 0.0

    def now_s(self) -> float:
        return self.time_s


def conversation(*commands: bytes) -> bytes:
    wire = Wire()
    device = ScipDevice(wire, Clock())  # type: ignore[arg-type]
    for command in commands:
        device.receive(command)
    return wire.sent


@pytest.mark.parametrize(
    ("commands", "answer"),
    [
        ((b"\nQT\n",), b"QT\n00P\n\n"),
        ((b"BM\r",), b"BM\n00P\n\n"),
        ((b"BM\n", b"BM\n"), b"BM\n00P\n\nBM\n02R\n\n"),
        ((b"BM;hello\n",), b"BM;hello\n00P\n\n"),
        ((b"XY\n",), b"XY\n0Ee\n\n"),
        ((b"GD0044072501\n",), b"GD0044072501\n10Q\n\n"),
        ((b"GD0044072601\n",), b"GD0044072601\n04T\n\n"),
        ((b"GDxx44072501\n",), b"GDxx44072501\n01Q\n\n"),
        ((b"GD0100005001\n",), b"GD0100005001\n05U\n\n"),
        ((b"MD004407250x000\n",), b"MD004407250x000\n03S\n\n"),
        ((b"SS115200\n",), b"SS115200\n03S\n\n"),
        ((b"SS000300\n",), b"SS000300\n04T\n\n"),
        ((b"TM1\n",), b"TM1\n04T\n\n"),
        ((b"TM0\n", b"TM0\n"), b"TM0\n00P\n\nTM0\n02R\n\n"),
        ((b"TM0\n", b"TM1\n"), b"TM0\n00P\n\nTM1\n00P\n00000\n\n"),
    ],
)
def test_the_mock_answers_as_the_specification_says(commands: tuple[bytes, ...], answer: bytes) -> None:
    assert conversation(*commands) == answer


def test_the_mock_counts_down_the_scans_that_were_asked_for() -> None:
    wire, clock = Wire(), Clock()
    device = ScipDevice(wire, clock)  # type: ignore[arg-type]
    device.receive(b"MS0380038901002\n")
    for k in range(1, 40):
        clock.time_s = 0.1 * k + 0.01
        device.collect()
    heads = [block.split(b"\n")[:2] for block in wire.sent.split(b"\n\n")[:-1]]
    expected = [[b"MS0380038901002", b"00P"], [b"MS0380038901001", b"99b"], [b"MS0380038901000", b"99b"]]
    assert heads == expected
