"""What is a reply of SCIP 2 and what is not, byte by byte, and what is counted on the way."""

from __future__ import annotations

import pytest

from drivers.scanner.scip_codec import (
    Reply,
    ReplyReader,
    decode,
    decode_one,
    is_sound,
    line_sum,
    parameters,
    parse_reply,
)


def with_sum(content: bytes) -> bytes:
    return content + bytes([(sum(content) & 0x3F) + 0x30])


FULL = with_sum(b"0" * 64)


@pytest.mark.parametrize(
    ("block", "reply"),
    [
        (b"QT\n00P", Reply("QT", "00")),
        (b"Q\n00P", None),  # an echo has two letters
        (b"QT", None),
        (b"Q1\n00P", None),
        (b"\xe9T\n00P", None),
        (b"QT\xe9\n00P", None),
        (b"QT\n0P", None),  # a status has two characters and a sum
        (b"QT\n000P", None),
        (b"QT\n00Q", None),
        (b"VV\n00P\nA:1" + with_sum(b"A:1")[-1:], Reply("VV", "00", (b"A:1",))),
        (b"VV\n00P\nA:1x", None),
        (b"GD\n00P\n0038;\n" + FULL, Reply("GD", "00", (b"0038", b"0" * 64))),
        (b"GD\n00P\n0038;\n" + FULL + b"\n" + FULL, Reply("GD", "00", (b"0038", b"0" * 64, b"0" * 64))),
        (b"GD\n00P\n0038;\n" + FULL + b"\n07W", Reply("GD", "00", (b"0038", b"0" * 64, b"07"))),
        (b"GD\n00P\n0038;\n" + FULL + b"\n07X", None),
        (b"GD\n00P\n0038;\n" + FULL[:-1] + b"1\n07W", None),
        (b"GD\n00P\n0038;\n" + b"0" * 31 + b"1" + FULL[32:] + b"\n" + FULL, None),
        (b"GD\n00P\n0039;\n" + FULL, None),  # the time stamp's sum
        (b"GD\n00Q\n0038;\n" + FULL, None),
        (b"GD\n00P\n0038;\n" + b"\x1f" * 64 + bytes([((0x1F * 64) & 0x3F) + 0x30]), None),  # not printable
        (b"GD\n00P\n0038;\n" + b"\x7f" * 64 + bytes([((0x7F * 64) & 0x3F) + 0x30]), None),
    ],
)
def test_a_block_is_a_reply_only_if_every_line_of_it_is_sound(block: bytes, reply: Reply | None) -> None:
    assert parse_reply(block) == reply


def test_lines_of_another_length_among_full_ones_are_judged_one_by_one() -> None:
    short, long = with_sum(b"0" * 63), with_sum(b"0" * 65)
    (reply,) = ReplyReader().feed(b"GD\n00P\n0038;\n" + short + b"\n" + long + b"\n" + FULL + b"\n\n")
    assert reply.lines[1:] == (b"0" * 63, b"0" * 65, b"0" * 64)
    spoiled = b"GD\n00P\n0038;\n" + short + b"\n" + long[:-1] + b"z\n" + FULL + b"\n\n"
    assert ReplyReader().feed(spoiled) == []


@pytest.mark.parametrize(
    ("line", "sound"),
    [
        (b"0", False),
        (b"00", False),
        (b"0`", True),
        (b" P", True),
        (b"~n", True),
        (b"\x1fO", False),
        (b"\x7fo", False),
        (b"A:1;" + with_sum(b"A:1")[-1:], True),
        (b"A:1;" + with_sum(b"A:1;")[-1:], True),
        (b"A;1" + with_sum(b"A1")[-1:], False),
        (b";0", True),  # nothing but a semicolon, and the sum of nothing
    ],
)
def test_a_line_is_sound_by_its_last_character(line: bytes, sound: bool) -> None:
    assert is_sound(line) is sound


def test_the_sum_is_the_low_six_bits_from_a_zero_on() -> None:
    assert [line_sum(text) for text in (b"", b"\x3f", b"\x40", b"00", b"99")] == [0x30, 0x6F, 0x30, 0x50, 0x62]


def counts(reader: ReplyReader) -> dict[str, int]:
    return dict(reader.counters.as_pairs())


def test_what_comes_and_what_is_dropped_is_counted() -> None:
    reader = ReplyReader()
    assert len(reader.feed(b"\n\nQT\n00P\n\n\n\nQT\n00Q\n\nBM\n00P\n\nQ")) == 2
    assert counts(reader) == {"bytes": 29, "replies": 2, "bytes_dropped": 8, "bad_checksum": 1}
    assert reader.feed(b"T\n00P\n\nBM\n00Q\n\nRS") == [Reply("QT", "00")]
    assert counts(reader) == {"bytes": 46, "replies": 3, "bytes_dropped": 16, "bad_checksum": 2}
    reader.flush()
    assert counts(reader)["bytes_dropped"] == 18
    assert reader.feed(b"\nQT\n00P\n\n") == [Reply("QT", "00")], "the unfinished reply is forgotten"


def test_of_a_reply_without_end_no_more_than_64_kilobytes_are_kept() -> None:
    reader = ReplyReader()
    reader.feed(b"Q" * (1 << 16))
    assert counts(reader)["bytes_dropped"] == 0
    reader.feed(b"Q")
    assert counts(reader)["bytes_dropped"] == (1 << 16) + 1
    reader.feed(b"Q" * ((1 << 16) + 5))
    assert counts(reader)["bytes_dropped"] == (1 << 17) + 6
    assert reader.feed(b"QT\n00P\n\n") == [Reply("QT", "00")]


@pytest.mark.parametrize(
    ("text", "characters", "number"),
    [
        (b"0038", 4, 200), (b"oooo", 4, 16777215), (b"0000", 4, 0), (b"1000", 4, 262144), (b"m2@0", 4, 16000000),
        (b"038", 4, None), (b"00038", 4, None), (b"00/8", 4, None), (b"00p8", 4, None), (b"/", 1, None), (b"o", 1, 63),
    ],
)  # fmt: skip
def test_one_number_is_read_or_refused(text: bytes, characters: int, number: int | None) -> None:
    assert decode_one(text, characters) == number


@pytest.mark.parametrize(("lines", "characters"), [((b"0000", b"0"), 3), ((b"00/",), 3), ((b"00p",), 3)])
def test_a_block_that_does_not_hold_whole_numbers_is_refused(lines: tuple[bytes, ...], characters: int) -> None:
    assert decode(lines, characters) is None


def test_a_block_without_numbers_is_empty() -> None:
    none = decode((), 3)
    assert none is not None
    assert none.tolist() == []


def test_a_parameters_value_may_hold_a_colon_and_a_line_without_one_is_none() -> None:
    reply = Reply("VV", "00", (b"TIME:12:30;", b"nothing;", b"EMPTY:;", b"LAST:x;;", b";XX:X;"))
    assert parameters(reply) == (("TIME", "12:30"), ("EMPTY", ""), ("LAST", "x"), (";XX", "X"))
