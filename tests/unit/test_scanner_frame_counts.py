"""What the frame parser counts, numbers and keeps, in streams whose formats have less than the usual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.frame_format import Checksum, Command, CounterField, Field, FrameFormat, PointArray, Scaling
from drivers.scanner.frame_parser import FrameParser
from tests.unit.test_scanner_frames import FRAME_7, SMALL, counts, small_frame

# sync A5 | 2 x (u8 z, u8 intensity) | sum of all bytes before it; no clock, no number
PLAIN = FrameFormat(
    sync=b"\xa5",
    byte_order="big",
    header=(),
    points=PointArray("z", 2, (Field("z", "u8"), Field("intensity", "u8")), Scaling(0.01), (0,), x_step_m=0.5),
    checksum=Checksum("sum8"),
)
PLAIN_FRAME = bytes.fromhex("A5 0A 21 00 22 F2")  # 0xA5 + 0x0A + 0x21 + 0x22 = 0xF2; the second was not measured


def test_without_a_number_and_a_clock_profiles_are_numbered_as_they_come() -> None:
    parser = FrameParser(PLAIN)
    profiles = parser.feed(PLAIN_FRAME * 2, 1_500_000_000) + parser.feed(PLAIN_FRAME, 2_500_000_000)
    assert [profile.sequence for profile in profiles] == [0, 1, 2]
    assert [profile.time_s for profile in profiles] == [1.5, 1.5, 2.5]
    assert [profile.device_time_s for profile in profiles] == [None] * 3


def test_a_profile_holds_what_was_measured_with_its_light_and_share() -> None:
    (profile,) = FrameParser(PLAIN).feed(PLAIN_FRAME, 0)
    np.testing.assert_allclose(profile.points, [[0.0, 0.1]])
    assert profile.intensity is not None
    assert profile.intensity.tolist() == [0x21]
    assert profile.quality == 0.5


@pytest.mark.parametrize("count", [1, 2, 63, 64, 65, 200])
def test_any_number_of_frames_in_one_piece_are_found(count: int) -> None:
    parser = FrameParser(SMALL)
    profiles = parser.feed(b"".join(small_frame(k) for k in range(count)), 0)
    assert [profile.sequence for profile in profiles] == list(range(count))
    assert counts(parser) == {
        "bytes": 15 * count, "frames": count, "bytes_dropped": 0, "bad_checksum": 0, "unconfirmed": 0, "lost": 0,
        "stale": 0,
    }  # fmt: skip


def test_a_bad_frame_among_many_costs_itself_alone() -> None:
    spoiled = small_frame(20)[:-1] + bytes([small_frame(20)[-1] ^ 1])
    stream = b"".join(spoiled if k == 20 else small_frame(k) for k in range(40))
    parser = FrameParser(SMALL)
    assert [profile.sequence for profile in parser.feed(stream, 0)] == [k for k in range(40) if k != 20]
    assert counts(parser) == {
        "bytes": 600, "frames": 39, "bytes_dropped": 15, "bad_checksum": 1, "unconfirmed": 0, "lost": 1, "stale": 0,
    }  # fmt: skip


def test_what_is_dropped_is_counted_over_the_whole_stream() -> None:
    parser = FrameParser(SMALL)
    parser.feed(b"\x01\x02\x03" + small_frame(1) + b"\x04\x05", 0)
    assert counts(parser)["bytes_dropped"] == 5
    parser.feed(b"\x06" + small_frame(2)[:5], 0)
    assert counts(parser)["bytes_dropped"] == 6
    parser.abandon_partial()
    parser.feed(b"", 0)
    assert counts(parser)["bytes_dropped"] == 11
    parser.abandon_partial()
    assert counts(parser)["bytes_dropped"] == 11, "nothing was begun"
    assert counts(parser)["frames"] == 1


def test_after_a_restart_any_number_may_come_and_none_is_lost() -> None:
    parser = FrameParser(SMALL)
    parser.feed(small_frame(200), 0)
    parser.restart()
    assert len(parser.feed(small_frame(3) + small_frame(4), 0)) == 2
    assert counts(parser)["lost"] == 0
    assert counts(parser)["stale"] == 0
    plain = FrameParser(PLAIN)
    plain.restart()
    assert len(plain.feed(PLAIN_FRAME, 0)) == 1


CONFIRMED = FrameFormat(
    sync=b"\xa5\x5a",
    byte_order="big",
    header=(Field("kind", "u8", const=7), Field("number", "u8")),
    points=PointArray("z", 1, (Field("z", "u8"),), Scaling(0.01)),
    checksum=Checksum("sum8", from_byte=2),
    sequence=CounterField("number", 256),
    confirmed_by_next=True,
)


def confirmed_frame(number: int, kind: int = 7) -> bytes:
    return bytes([0xA5, 0x5A, kind, number, 9, kind + number + 9])


def test_where_a_frame_must_be_confirmed_the_last_one_waits_for_the_next_ones_sync() -> None:
    parser = FrameParser(CONFIRMED)
    assert [p.sequence for p in parser.feed(b"".join(map(confirmed_frame, (1, 2, 3))), 0)] == [1, 2]
    assert parser.feed(b"\xa5", 0) == []
    assert [p.sequence for p in parser.feed(b"\x5a", 0)] == [3]
    assert counts(parser)["unconfirmed"] == 0


def test_a_frame_that_none_follows_is_unconfirmed_and_the_run_goes_on_behind_it() -> None:
    parser = FrameParser(CONFIRMED)
    stream = confirmed_frame(1) + confirmed_frame(2) + b"\x00" + confirmed_frame(3) + confirmed_frame(4)
    assert [p.sequence for p in parser.feed(stream, 0)] == [1, 3]
    assert counts(parser)["unconfirmed"] == 1
    assert counts(parser)["bad_checksum"] == 0
    assert counts(parser)["bytes_dropped"] == 7


def test_a_wrong_constant_is_no_bad_checksum_and_a_wrong_sum_is_one() -> None:
    parser = FrameParser(CONFIRMED)
    wrong_sum = confirmed_frame(2)[:-1] + b"\x00"
    stream = confirmed_frame(1, kind=8) + wrong_sum + confirmed_frame(3) + b"\xa5\x5a"
    assert [p.sequence for p in parser.feed(stream, 0)] == [3]
    assert counts(parser)["bad_checksum"] == 1
    assert counts(parser)["unconfirmed"] == 0
    assert counts(parser)["bytes_dropped"] == 12


def test_an_answer_is_taken_only_where_the_device_gives_one() -> None:
    silent = FrameParser(replace(SMALL, start=Command(b"on\n"), stop=None))
    assert len(silent.feed(b"ON!OFF!" + FRAME_7, 0)) == 1
    assert silent.acks == []
    assert counts(silent)["bytes_dropped"] == 7
    answering = FrameParser(SMALL)
    assert len(answering.feed(b"ON!OFF!" + FRAME_7, 0)) == 1
    assert answering.acks == [b"ON!", b"OFF!"]
    assert counts(answering)["bytes_dropped"] == 0


def test_a_begun_answer_or_frame_is_kept_and_what_cannot_become_one_is_not() -> None:
    parser = FrameParser(SMALL)
    for begun in (b"O", b"OF", b"\xca", b"\xca\xfe", FRAME_7[:-1]):
        parser.feed(b"\x00" + begun, 0)
        dropped = counts(parser)["bytes_dropped"]
        parser.feed(b"", 0)
        assert counts(parser)["bytes_dropped"] == dropped
        parser.abandon_partial()
        parser.feed(b"\x00" * 20, 0)
    assert counts(parser)["bytes"] == counts(parser)["bytes_dropped"]


def test_a_parser_that_has_seen_nothing_has_counted_nothing() -> None:
    assert dict(FrameParser(PLAIN).counters.as_pairs()) == dict.fromkeys(
        ("bytes", "frames", "bytes_dropped", "bad_checksum", "unconfirmed", "lost", "stale"), 0
    )
