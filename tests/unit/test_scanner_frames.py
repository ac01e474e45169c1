"""The frame parser against literal bytes and against whatever a line may make of them."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from crccheck.crc import Crc8Base, Crc16CcittFalse
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.scanner_files import load_scanner
from drivers.frame_format import Checksum, Command, CounterField, Field, FrameFormat, PointArray, Scaling
from drivers.scanner.frame_parser import FrameParser

# sync CA FE | u8 number | u16 time | 2 x (i16 x, u16 z) big-endian | CRC-16/CCITT-FALSE over everything before it
SMALL = FrameFormat(
    sync=b"\xca\xfe",
    byte_order="big",
    header=(Field("number", "u8"), Field("time", "u16")),
    points=PointArray(
        "xz", 2, (Field("x", "i16"), Field("z", "u16")), Scaling(1e-4, 0.1), (0xFFFF,), x_scaling=Scaling(1e-3)
    ),
    checksum=Checksum("crc16", poly=0x1021, init=0xFFFF),
    clock=CounterField("time", 65536, 1e-3),
    sequence=CounterField("number", 256),
    start=Command(b"on\n", b"ON!"),
    stop=Command(b"off\n", b"OFF!"),
)
# x -1 mm, z 0.1 + 0.0256 m; x 2 mm, no z. Checksum worked out with an independent CRC tool (crccheck).
FRAME_7 = bytes.fromhex("CAFE 07 0102 FFFF 0100 0002 FFFF FF09")


NEXT_LD19 = b"\x54\x2c"
"""A frame counts once the next one begins right behind it."""


class Ld19Crc(Crc8Base):
    _poly = 0x4D
    _initvalue = 0


def small_frame(number: int, time_ms: int = 0, z: int = 256) -> bytes:
    body = b"\xca\xfe" + bytes([number & 0xFF]) + (time_ms & 0xFFFF).to_bytes(2, "big")
    body += b"\xff\xff" + z.to_bytes(2, "big") + b"\x00\x02\xff\xff"
    return body + Crc16CcittFalse.calc(body).to_bytes(2, "big")


def ld19_frame(range_mm: int) -> bytes:
    body = b"\x54\x2c\x10\x0e\x00\x00" + (range_mm.to_bytes(2, "little") + b"\xc8") * 12 + b"\x03\x00\x01\x00"
    return body + bytes([Ld19Crc.calc(body)])


def counts(parser: FrameParser) -> dict[str, int]:
    return dict(parser.counters.as_pairs())


def test_a_frame_of_literal_bytes_becomes_a_profile() -> None:
    (profile,) = FrameParser(SMALL).feed(FRAME_7, 5_000_000_000)
    assert profile.sequence == 7
    assert profile.time_s == 5.0
    assert profile.device_time_s == pytest.approx(0.258)
    np.testing.assert_allclose(profile.points, [[-0.001, 0.1256]])
    assert profile.quality == 0.5


def test_an_ld19_frame_of_literal_bytes_becomes_points_around_the_lidar() -> None:
    # the frame that the maker's manual prints: 324.27 to 334.70 degrees, 0x1A3A ms, 224 mm, 220 mm, ...
    frame = bytes.fromhex(
        "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4 CA 00 E2 C7 00 E9 C5 00 E5 "
        "C2 00 E5 C0 00 E5 BE 82 3A 1A 50"
    )
    parser = FrameParser(load_scanner("ld19").layout)
    assert parser.feed(frame, 0) == []
    (profile,) = parser.feed(NEXT_LD19, 0)
    assert profile.device_time_s == pytest.approx(6.714)
    ranges = np.hypot(profile.points[:, 0], profile.points[:, 1])
    np.testing.assert_allclose(ranges[:3], [0.224, 0.220, 0.217])
    angles = np.degrees(np.arctan2(profile.points[:, 0], profile.points[:, 1])) % 360
    np.testing.assert_allclose(angles[[0, -1]], [324.27, 334.70], atol=1e-9)
    assert profile.intensity is not None
    assert profile.intensity[:2].tolist() == [0xE4, 0xE2]


def test_a_broken_ld19_frame_with_a_good_crc_by_chance_is_no_profile_unless_the_next_one_follows() -> None:
    """Once in 256 lost bytes, the next frame's first byte is the checksum of what stands before it."""
    whole = ld19_frame(200)
    number = next(n for n in range(300) if Ld19Crc.calc(ld19_frame(n)[:20] + ld19_frame(n)[21:]) == NEXT_LD19[0])
    broken = ld19_frame(number)[:20] + ld19_frame(number)[21:]
    parser = FrameParser(load_scanner("ld19").layout)
    found = [profile for piece in (broken, whole * 3) for profile in parser.feed(piece, 0)]
    assert len(found) == 2
    assert all(profile.points[0, 1] == pytest.approx(0.2) for profile in found)
    assert counts(parser)["unconfirmed"] == 1
    assert counts(parser)["bytes_dropped"] == len(broken)


def test_ranges_across_the_zero_angle_keep_turning_forward() -> None:
    body = b"\x54\x2c\x00\x00" + (35500).to_bytes(2, "little") + b"\xe8\x03\x01" * 12
    body += (500).to_bytes(2, "little") + b"\x00\x00"
    crc = Ld19Crc.calc(body)
    (profile,) = FrameParser(load_scanner("ld19").layout).feed(body + bytes([crc]) + NEXT_LD19, 0)
    angles = np.degrees(np.arctan2(profile.points[:, 0], profile.points[:, 1]))
    np.testing.assert_allclose(angles, np.linspace(-5, 5, 12), atol=1e-9)


def test_the_wide_preset_decodes_a_frame_packed_by_hand() -> None:
    x = [(k - 500).to_bytes(2, "little", signed=True) for k in range(999)]
    points = b"".join(x[k] + (20000 + k).to_bytes(2, "little") for k in range(999))
    points += b"\x00\x00\xff\xff"
    body = bytes.fromhex("E803 0100 D2040000 40420F00") + points
    frame = b"\xa5\x5a\xc3\x3c" + body + zlib.crc32(body).to_bytes(4, "little")
    assert len(frame) == 4020
    (profile,) = FrameParser(load_scanner("wide_xz").layout).feed(frame, 0)
    assert profile.sequence == 1234
    assert profile.device_time_s == pytest.approx(1.0)
    assert profile.points.shape == (999, 2)
    np.testing.assert_allclose(profile.points[0], [-0.0025, 0.3])
    np.testing.assert_allclose(profile.points[-1], [498 * 5e-6, 0.1 + 20998e-5])


@pytest.mark.parametrize("cut", range(1, len(FRAME_7)))
def test_a_frame_in_two_chunks_is_one_profile(cut: int) -> None:
    parser = FrameParser(SMALL)
    assert parser.feed(FRAME_7[:cut], 1) == []
    (profile,) = parser.feed(FRAME_7[cut:], 2_000_000_000)
    assert profile.time_s == 2.0
    assert counts(parser)["bytes_dropped"] == 0


@pytest.mark.parametrize("cut", range(len(FRAME_7)))
def test_a_lost_byte_costs_its_own_frame_only(cut: int) -> None:
    stream = small_frame(1) + (small_frame(2)[:cut] + small_frame(2)[cut + 1 :]) + small_frame(3) + small_frame(4)
    parser = FrameParser(SMALL)
    assert [profile.sequence for profile in parser.feed(stream, 0)] == [1, 3, 4]
    assert counts(parser)["lost"] == 1
    assert counts(parser)["bytes_dropped"] == len(FRAME_7) - 1


def test_a_flipped_bit_is_a_bad_checksum_and_never_a_profile() -> None:
    for bit in range(16, 8 * len(FRAME_7)):
        spoiled = bytearray(small_frame(2))
        spoiled[bit // 8] ^= 1 << bit % 8
        parser = FrameParser(SMALL)
        assert [profile.sequence for profile in parser.feed(small_frame(1) + spoiled + small_frame(3), 0)] == [1, 3]
        assert counts(parser)["bad_checksum"] == 1


def test_a_wrong_constant_field_is_no_frame() -> None:
    layout = FrameFormat(
        b"\xca", "little", (Field("kind", "u8", const=3),), PointArray("z", 1, (Field("z", "u8"),), Scaling(1.0))
    )
    assert len(FrameParser(layout).feed(b"\xca\x03\x05\xca\x04\x05\xca\x03\x06", 0)) == 2


def test_sync_bytes_inside_the_data_do_not_disturb() -> None:
    stream = b"".join(small_frame(k, z=0xCAFE) for k in range(1, 6))
    assert [profile.sequence for profile in FrameParser(SMALL).feed(b"\xca" + stream, 0)] == [1, 2, 3, 4, 5]


def test_device_time_and_numbers_go_on_when_their_counters_wrap() -> None:
    parser = FrameParser(SMALL)
    stream = b"".join(small_frame(250 + k, 65530 + 2 * k) for k in range(12))
    profiles = parser.feed(stream, 0)
    assert [profile.sequence for profile in profiles] == list(range(250, 262))
    np.testing.assert_allclose([profile.device_time_s for profile in profiles], 65.530 + 0.002 * np.arange(12))
    assert counts(parser)["lost"] == 0


def test_wraps_missed_in_a_long_silence_are_found_by_the_hosts_time() -> None:
    parser = FrameParser(SMALL)
    (before,) = parser.feed(small_frame(1, 1000), 0)
    (after,) = parser.feed(small_frame(2, 2000), int((1 + 3 * 65.536 + 0.010) * 1e9))
    assert after.device_time_s is not None
    assert before.device_time_s is not None
    assert after.device_time_s - before.device_time_s == pytest.approx(1 + 3 * 65.536)


def test_repeated_and_old_frames_are_counted_and_not_handed_on() -> None:
    parser = FrameParser(SMALL)
    stream = small_frame(10) + small_frame(11) + small_frame(11) + small_frame(5) + small_frame(12)
    assert [profile.sequence for profile in parser.feed(stream, 0)] == [10, 11, 12]
    assert counts(parser)["stale"] == 2


def test_a_device_that_starts_over_is_believed_after_some_frames() -> None:
    parser = FrameParser(SMALL)
    profiles = parser.feed(b"".join(small_frame(k) for k in (100, 101, 1, 2, 3, 4, 5, 6)), 0)
    assert [profile.sequence for profile in profiles] == [100, 101, 102, 103]


def test_acknowledgements_are_seen_between_frames_and_in_pieces() -> None:
    parser = FrameParser(SMALL)
    assert len(parser.feed(small_frame(1) + b"ON", 0)) == 1
    assert parser.acks == []
    assert len(parser.feed(b"!" + small_frame(2) + b"OFF!", 0)) == 1
    assert parser.acks == [b"ON!", b"OFF!"]


def test_an_answer_hidden_behind_a_cut_frame_comes_out_once_the_frame_is_given_up() -> None:
    parser = FrameParser(SMALL)
    parser.feed(small_frame(1)[:6] + b"OFF!", 0)
    assert parser.acks == []
    parser.abandon_partial()
    parser.feed(b"", 0)
    assert parser.acks == [b"OFF!"]


@settings(max_examples=300, deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=8))
def test_any_bytes_are_taken_without_an_error_and_little_is_kept(chunks: list[bytes]) -> None:
    parser = FrameParser(SMALL)
    for chunk in chunks:
        parser.feed(chunk, 0)
    assert counts(parser)["bytes"] == sum(map(len, chunks))
    assert len(parser._rest) < SMALL.size


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_frames_are_found_in_garbage_however_it_is_cut(data: st.DataObject) -> None:
    garbage = st.binary(max_size=30).map(lambda raw: raw.replace(b"\xca", b"\x00").replace(b"O", b"o"))
    stream = b"".join(data.draw(garbage) + small_frame(k, z=1000 + k) for k in range(1, 9))
    parser = FrameParser(SMALL)
    profiles = []
    while stream:
        size = data.draw(st.integers(1, 60))
        profiles += parser.feed(stream[:size], 0)
        stream = stream[size:]
    assert [profile.sequence for profile in profiles] == list(range(1, 9))
    assert [round((p.points[0, 1] - 0.1) * 1e4) for p in profiles] == list(range(1001, 1009))


EDIT = st.tuples(st.sampled_from(["delete", "double", "flip"]), st.integers(0, 10**6), st.integers(0, 7))


@settings(max_examples=300, deadline=None)
@given(st.lists(EDIT, max_size=6))
def test_whatever_happens_to_the_bytes_no_wrong_profile_passes(edits: list[tuple[str, int, int]]) -> None:
    stream = bytearray(b"".join(small_frame(k, 10 * k, z=1000 + k) for k in range(1, 13)))
    for kind, place, bit in edits:
        at = place % len(stream)
        if kind == "delete":
            del stream[at]
        elif kind == "double":
            stream.insert(at, stream[at])
        else:
            stream[at] ^= 1 << bit
    profiles = FrameParser(SMALL).feed(bytes(stream), 0)
    for profile in profiles:
        np.testing.assert_allclose(profile.points, [[-0.001, 0.1 + (1000 + profile.sequence) * 1e-4]])
        assert profile.device_time_s == pytest.approx(profile.sequence * 0.01)
    assert len(profiles) >= 12 - len(edits)
