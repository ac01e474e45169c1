"""The mock's slcan adapter at byte level, and its own checksums, against literal bytes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocks.charger.checksum import fits
from mocks.charger.frames import BusFrame, Frames
from mocks.charger.lawicel import Lawicel
from tests.unit.charger_frames import FRAMES

OPENING = b"C\rS5\r\rO\r"


@pytest.fixture
def adapter() -> Lawicel:
    adapter = Lawicel(250_000)
    adapter.feed(OPENING)
    return adapter


def test_what_python_can_says_on_opening_is_understood() -> None:
    adapter = Lawicel(250_000)
    answers, frames = adapter.feed(b"C\rS5\r\rO\rO\r")
    assert answers == b"\a\r\r\a", "closed already; rate set; open; open already"
    assert frames == []
    assert adapter.on_bus


@pytest.mark.parametrize(
    ("line", "answer", "frame"),
    [
        (b"t1232AABB\r", b"z\r", BusFrame(0x123, b"\xaa\xbb", extended=False)),
        (
            b"T0CFF10B08052307ED01341200\r",
            b"Z\r",
            BusFrame(0x0CFF10B0, bytes.fromhex("052307ED01341200")),
        ),
        (b"r1234\r", b"z\r", BusFrame(0x123, b"", extended=False, remote=True)),
        (b"R000001234\r", b"Z\r", BusFrame(0x123, b"", remote=True)),
        (b"d1239" + b"11" * 12 + b"\r", b"z\r", BusFrame(0x123, b"\x11" * 12, extended=False, fd=True)),
        (b"B00000123D" + b"22" * 32 + b"\r", b"Z\r", BusFrame(0x123, b"\x22" * 32, fd=True)),
        (b"t12321234567\r", b"\a", None),
        (b"t1239\r", b"\a", None),
        (b"t12\r", b"\a", None),
        (b"t12G0\r", b"\a", None),
        (b"x\r", b"\a", None),
        (b"S5\r", b"\a", None),
        (b"V\r", b"V1013\r", None),
        (b"N\r", b"NA123\r", None),
        (b"F\r", b"F00\r", None),
        (b"\r", b"", None),
    ],
)
def test_each_line_has_its_answer(adapter: Lawicel, line: bytes, answer: bytes, frame: BusFrame | None) -> None:
    answers, frames = adapter.feed(line)
    assert answers == answer
    assert frames == ([] if frame is None else [frame])


def test_frames_to_the_host_are_literal_lines(adapter: Lawicel) -> None:
    status = BusFrame(0x0CFF2056, bytes.fromhex("F26092 0A2A020000"))
    assert adapter.tell(status) == b"T0CFF20568F260920A2A020000\r"
    assert adapter.tell(BusFrame(0x7FF, b"", extended=False)) == b"t7FF0\r"


def test_lines_may_arrive_in_pieces(adapter: Lawicel) -> None:
    line = b"t1232AABB\r"
    frames = [frame for byte in line for frame in adapter.feed(bytes((byte,)))[1]]
    assert frames == [BusFrame(0x123, b"\xaa\xbb", extended=False)]


def test_a_closed_channel_passes_nothing(adapter: Lawicel) -> None:
    assert adapter.feed(b"C\r")[0] == b"\r"
    assert adapter.feed(b"t1230\r") == (b"\a", [])
    assert adapter.tell(BusFrame(1, b"")) == b""


def test_a_listening_channel_hears_but_does_not_send() -> None:
    adapter = Lawicel(250_000)
    adapter.feed(b"S5\rL\r")
    assert adapter.feed(b"t1230\r") == (b"\a", [])
    assert adapter.tell(BusFrame(1, b"", extended=False)) == b"t0010\r"


def test_at_the_wrong_bit_rate_nothing_passes_and_the_status_says_so() -> None:
    adapter = Lawicel(250_000)
    adapter.feed(b"S6\rO\r")
    assert adapter.feed(b"t1230\rF\r") == (b"z\rF80\r", [])
    assert adapter.tell(BusFrame(1, b"")) == b""


@given(st.binary(max_size=300))
def test_any_bytes_are_survived(data: bytes) -> None:
    adapter = Lawicel(250_000)
    adapter.feed(OPENING)
    adapter.feed(data)
    adapter.feed(b"\rC\r" + OPENING)
    assert adapter.feed(b"t1230\r")[0] == b"z\r"


@pytest.mark.parametrize("name", FRAMES)
def test_the_mocks_own_checksum_fits_the_literal_frames(name: str) -> None:
    identifier, frame, _ = FRAMES[name]
    assert fits(bytes.fromhex(frame), "e2e-p11", identifier >> 8 & 0xFFFF)


@pytest.mark.parametrize("name", ["CH_Status", "CH_Electrical"])
def test_the_mock_encodes_the_literal_frames(name: str) -> None:
    identifier, frame, values = FRAMES[name]
    frames = Frames(None, "e2e-p11")
    sent = [frames.encode(name, {k: v for k, v in values.items() if k != "Counter"}) for _ in range(15)]
    assert sent[int(values["Counter"])] == BusFrame(identifier, bytes.fromhex(frame))


@pytest.mark.parametrize("name", ["RC_Heartbeat", "RC_Command", "RC_DockPos", "RC_DockRot", "RC_DockQuality"])
def test_the_mock_reads_the_literal_frames_and_no_damaged_one(name: str) -> None:
    identifier, frame, values = FRAMES[name]
    frames = Frames(None, "e2e-p11")
    decoded = frames.decode(BusFrame(identifier, bytes.fromhex(frame)))
    assert decoded is not None
    assert decoded[0] == name
    assert {k: decoded[1][k] for k in values} == pytest.approx(values)
    for bit in range(64):
        damaged = bytearray(bytes.fromhex(frame))
        damaged[bit // 8] ^= 1 << bit % 8
        assert frames.decode(BusFrame(identifier, bytes(damaged))) is None
