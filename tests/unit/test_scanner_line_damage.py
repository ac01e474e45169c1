"""Whatever one damage does to the bytes of a scanner, no wrong profile passes for good, and the next one is found.

Damage: a bit flipped, a byte deleted, a frame broken off after any byte, garbage before it; and any way of cutting the
stream into reads. `make test` draws 150 cases for each codec, `make long` 10,000.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from controller.scanner_files import load_scanner
from drivers.scanner import profiler2_codec, scip_codec
from drivers.scanner.frame_parser import FrameParser
from mocks.scanner import ld19, profiler2, scip, wide_xz

FEW, MANY = 150, 10_000


@dataclass(frozen=True)
class Damage:
    """What happens to one frame, and how the whole stream is cut into reads."""

    kind: Literal["flip", "delete", "break off", "garbage"]
    place: float
    """Where in the frame, 0 to 1."""
    bit: int
    garbage: bytes
    cuts: tuple[int, ...]

    def spoil(self, frame: bytes) -> bytes:
        at = min(int(self.place * len(frame)), len(frame) - 1)
        match self.kind:
            case "flip":
                return frame[:at] + bytes([frame[at] ^ 1 << self.bit]) + frame[at + 1 :]
            case "delete":
                return frame[:at] + frame[at + 1 :]
            case "break off":
                return frame[:at]
            case _:
                return self.garbage + frame

    def reads(self, stream: bytes) -> list[bytes]:
        pieces, position, turn = [], 0, 0
        while position < len(stream):
            size = self.cuts[turn % len(self.cuts)]
            pieces.append(stream[position : position + size])
            position, turn = position + size, turn + 1
        return pieces


DAMAGE = st.builds(
    Damage,
    st.sampled_from(["flip", "delete", "break off", "garbage"]),
    st.floats(0.0, 1.0),
    st.integers(0, 7),
    st.binary(max_size=40),
    st.tuples(st.integers(1, 40), st.integers(200, 5000), st.integers(1, 5000)),
)


def few_and_many(check: Callable[[Damage], None]) -> tuple[Callable[[], None], Callable[[], None]]:
    """The same property as a short test and as a long one."""
    quick = settings(max_examples=FEW, deadline=None)(given(DAMAGE)(check))
    thorough = settings(max_examples=MANY, deadline=None, suppress_health_check=list(HealthCheck))(given(DAMAGE)(check))
    return quick, pytest.mark.long(pytest.mark.timeout(1800)(thorough))


# --- framed: the wide preset and the LD19 --------------------------------------------------------------------------


def line_of(number: int) -> np.ndarray:  # type: ignore[type-arg]
    x = np.linspace(-0.07, 0.07, 1000)
    return np.stack([np.round(x / 5e-6) * 5e-6, 0.3 + 1e-5 * (np.arange(1000) % 97) + 1e-4 * number], axis=1)


WIDE = load_scanner("wide_xz").layout
WIDE_FRAMES = [wide_xz.encode(line_of(k), k, 0.01 * k) for k in range(3)]
LD19 = load_scanner("ld19").layout
LD19_FRAMES = [ld19.packet(k, 0.01 * k) for k in range(5)]
LD19_POINTS = [FrameParser(LD19).feed(frame + frame[:2], 0)[0].points.tobytes() for frame in LD19_FRAMES]


def framed(damage: Damage) -> None:
    parser = FrameParser(WIDE)
    stream = WIDE_FRAMES[0] + damage.spoil(WIDE_FRAMES[1]) + WIDE_FRAMES[2]
    found = [profile for piece in damage.reads(stream) for profile in parser.feed(piece, 0)]
    assert {0, 2} <= {profile.sequence for profile in found}
    for profile in found:
        np.testing.assert_allclose(profile.points, line_of(profile.sequence), atol=1e-9)
        assert profile.device_time_s == pytest.approx(0.01 * profile.sequence)


def framed_ld19(damage: Damage) -> None:
    """Its CRC of 8 bits alone would let one in 256 cases pass: the next frame must stand right behind a frame."""
    parser = FrameParser(LD19)
    stream = b"".join(LD19_FRAMES[:2]) + damage.spoil(LD19_FRAMES[2]) + b"".join(LD19_FRAMES[3:]) + LD19_FRAMES[0]
    found = [profile.points.tobytes() for piece in damage.reads(stream) for profile in parser.feed(piece, 0)]
    assert set(found) <= set(LD19_POINTS), "no wrong profile passes"
    assert {LD19_POINTS[0], *LD19_POINTS[3:]} <= set(found), "only the damaged frame and the one before it may be lost"


test_framed_wide_xz, test_framed_wide_xz_10_000 = few_and_many(framed)
test_framed_ld19, test_framed_ld19_10_000 = few_and_many(framed_ld19)


# --- Profiler 2: one answer at a time; what is left of one is forgotten before the next question --------------------

ADDRESS = (0x0306, 0x2004)
WORDS = [0x0306, 0x2004, *(np.arange(252) * 263 % 65536).tolist()]
ANSWER = profiler2.packet(0x0002, b"".join(int(word).to_bytes(2, "big") for word in WORDS))


def fitting(packets: Sequence[profiler2_codec.Packet]) -> list[list[int]]:
    """What the driver would take for the answer: command, number of words and echoed address agree."""
    return [
        packet.words.tolist()
        for packet in packets
        if packet.command == 0x0002 and len(packet.words) == 254 and tuple(packet.words[:2].tolist()) == ADDRESS
    ]


def profiler2_answer(damage: Damage) -> None:
    reader = profiler2_codec.PacketReader()
    packets = [packet for piece in damage.reads(damage.spoil(ANSWER)) for packet in reader.feed(piece)]
    assert all(words == WORDS for words in fitting(packets))
    reader.flush()
    packets = [packet for piece in damage.reads(ANSWER) for packet in reader.feed(piece)]
    assert fitting(packets) == [WORDS]


test_profiler2, test_profiler2_10_000 = few_and_many(profiler2_answer)


# --- SCIP -----------------------------------------------------------------------------------------------------------

RANGES = (np.arange(682) * 37 % 5000 + 20).tolist()
HEAD = b"MD0044072501000\n99b\n" + scip.encode(np.array([123456]), 4)
SCAN = HEAD + scip.encode(np.array(RANGES), 3) + b"\n"


def scip_scan(damage: Damage) -> None:
    reader = scip_codec.ReplyReader()
    stream = SCAN + damage.spoil(SCAN) + SCAN + SCAN
    found = []
    for piece in damage.reads(stream):
        for reply in reader.feed(piece):
            values = scip_codec.decode(reply.lines[1:], 3)
            if reply.status == "99" and reply.echo[:2] == "MD" and values is not None and len(values) == 682:
                found.append(values.tolist())
                ticks = scip_codec.decode(reply.lines[:1], 4)
                assert ticks is not None
                assert ticks.tolist() == [123456]
    assert len(found) >= 2, "at most the damaged scan and one beside it are lost"
    assert all(values == RANGES for values in found)


test_scip, test_scip_10_000 = few_and_many(scip_scan)
