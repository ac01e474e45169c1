"""Every command and reply of SCIP 2 as literal bytes, on both sides of the line.

Sums are the specification's: the low six bits of the characters' sum, plus 0x30; worked out here by hand or taken from
its examples.
"""

from __future__ import annotations

import numpy as np
import pytest

from drivers.base import LinkLostError, MonotonicClock, NullSink
from drivers.scanner.scip import ScipGeometry, ScipScanner, ScipSettings
from drivers.scanner.scip_codec import Reply, ReplyReader, decode, parameters, parse_reply
from drivers.scanner.serial_link import SerialSettings
from mocks.scanner.scip import ScipDevice
from tests.unit.test_scanner_scip_codec import Clock, Wire


def talk(*commands: bytes, at_s: float = 0.0, then_s: float | None = None) -> bytes:
    """What the mock says to the commands, and to the passing of time after them."""
    wire, clock = Wire(), Clock()
    clock.time_s = at_s
    device = ScipDevice(wire, clock)  # type: ignore[arg-type]
    for command in commands:
        device.receive(command)
    if then_s is not None:
        wire.sent = b""
        clock.time_s = then_s
        device.collect()
    return wire.sent


# --- commands without data, and their statuses ----------------------------------------------------------------------

EXCHANGES = [
    ((b"BM\n",), b"BM\n00P\n\n"),
    ((b"BM\n", b"BM\n"), b"BM\n00P\n\nBM\n02R\n\n"),
    ((b"QT\n",), b"QT\n00P\n\n"),
    ((b"RS\n",), b"RS\n00P\n\n"),
    ((b"RT\n",), b"RT\n00P\n\n"),
    ((b"SS019200\n",), b"SS019200\n00P\n\n"),
    ((b"SS115200\n",), b"SS115200\n03S\n\n"),
    ((b"SS123456\n",), b"SS123456\n04T\n\n"),
    ((b"TM0\n",), b"TM0\n00P\n\n"),
    ((b"TM0\n", b"TM0\n"), b"TM0\n00P\n\nTM0\n02R\n\n"),
    ((b"TM0\n", b"TM1\n"), b"TM0\n00P\n\nTM1\n00P\n00000\n\n"),  # 0 ms: 0000 and its sum 0
    ((b"TM1\n",), b"TM1\n04T\n\n"),
    ((b"TM0\n", b"TM2\n"), b"TM0\n00P\n\nTM2\n00P\n\n"),
    ((b"TM2\n",), b"TM2\n03S\n\n"),
    ((b"%ST\n",), b"%ST\n00P\n000@\n\n"),
    ((b"BM\n", b"%ST\n"), b"BM\n00P\n\n%ST\n00P\n003C\n\n"),
    ((b"ZZ\n",), b"ZZ\n0Ee\n\n"),
    ((b"GD0380038901\n",), b"GD0380038901\n10Q\n\n"),  # the laser is off
    ((b"MD0380038901000\n",), b"MD0380038901000\n00P\n\n"),
    ((b"ME0380038901099\n",), b"ME0380038901099\n00P\n\n"),
    ((b"MS0380038901001;abc\n",), b"MS0380038901001;abc\n00P\n\n"),
    ((b"MDx380038901000\n",), b"MDx380038901000\n01Q\n\n"),
    ((b"MD0380x38901000\n",), b"MD0380x38901000\n02R\n\n"),
    ((b"MD03800389x1000\n",), b"MD03800389x1000\n03S\n\n"),
    ((b"MD0380072601000\n",), b"MD0380072601000\n04T\n\n"),
    ((b"MD0389038001000\n",), b"MD0389038001000\n05U\n\n"),
    ((b"MD0380038901x00\n",), b"MD0380038901x00\n06V\n\n"),
    ((b"MD03800389010x0\n",), b"MD03800389010x0\n07W\n\n"),
    ((b"MD038003890100\n",), b"MD038003890100\n0Cc\n\n"),  # too short
]


@pytest.mark.parametrize(("commands", "answer"), EXCHANGES)
def test_the_mock_answers_each_command_with_these_bytes(commands: tuple[bytes, ...], answer: bytes) -> None:
    assert talk(*commands) == answer


@pytest.mark.parametrize(("_", "answer"), EXCHANGES)
def test_the_driver_reads_echo_and_status_from_these_bytes(_: object, answer: bytes) -> None:
    replies = ReplyReader().feed(answer)
    blocks = [block.split(b"\n") for block in answer.split(b"\n\n")[:-1]]
    readable = [block for block in blocks if block[0][:2].isalpha()]  # %ST is asked by other clients only
    assert [(reply.echo.encode(), reply.status.encode()) for reply in replies] == [(b[0], b[1][:2]) for b in readable]


# --- information ----------------------------------------------------------------------------------------------------


def by_hand(content: bytes) -> bytes:
    return content + b";" + bytes([(sum(content) & 0x3F) + 0x30]) + b"\n"


def test_version_parameters_and_state_are_lines_of_key_and_value() -> None:
    keys = [b"VEND:portdock", b"PROD:mock range finder", b"FIRM:1.0.0(mock)", b"PROT:SCIP 2.0", b"SERI:H0000001"]
    assert talk(b"VV\n") == b"VV\n00P\n" + b"".join(by_hand(key) for key in keys) + b"\n"
    (reply,) = ReplyReader().feed(talk(b"PP\n"))
    assert dict(parameters(reply)) == {
        "MODL": "URG-04LX(mock)", "DMIN": "20", "DMAX": "5600", "ARES": "1024", "AMIN": "44", "AMAX": "725",
        "AFRT": "384", "SCAN": "600",
    }  # fmt: skip
    (state,) = ReplyReader().feed(talk(b"II\n"))
    assert [key for key, _ in parameters(state)] == ["MODL", "LASR", "SCSP", "MESM", "SBPS", "TIME", "STAT"]
    assert dict(parameters(state))["LASR"] == "OFF"


def test_the_specifications_parameter_lines_are_read() -> None:
    """The example of C-42-03320B for a URG-04LX: the sum leaves out the semicolon."""
    text = (
        b"PP\n00P\n" + by_hand(b"MODL:URG-04LX(Hokuyo Automatic Co.,Ltd.)") + b"DMIN:20;4\nDMAX:5600;_\nARES:1024;\\\n"
    )
    (reply,) = ReplyReader().feed(text + b"\n")
    assert parameters(reply)[1:] == (("DMIN", "20"), ("DMAX", "5600"), ("ARES", "1024"))


# --- measurements ---------------------------------------------------------------------------------------------------
# Steps 44 to 47 of the room are below DMIN: 7 mm, an error code. Time 0.2 s is 200 ms: 0038 -> 0, 0, 3, 8.


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"GD0044004701\n", b"GD0044004701\n00P\n0038;\n007007007007L\n\n"),
        (b"GS0044004701\n", b"GS0044004701\n00P\n0038;\n07070707L\n\n"),
        (b"GD0044004702\n", b"GD0044004702\n00P\n0038;\n007007^\n\n"),
        (b"GE0044004501\n", b"GE0044004501\n00P\n0038;\n0070@D0070@EG\n\n"),  # intensities 1044 and 1045
    ],
)
def test_single_scans_are_these_bytes(command: bytes, answer: bytes) -> None:
    said = talk(b"BM\n", command, at_s=0.2)[len(b"BM\n00P\n\n") :]
    (ours,), (theirs,) = ReplyReader().feed(said), [reply_of(answer)]
    assert said.split(b"\n")[:2] == answer.split(b"\n")[:2]
    assert ours.lines == theirs.lines
    assert said == answer


def reply_of(answer: bytes) -> Reply:
    """The reply whose lines have right sums by the driver's own reckoning."""
    found = parse_reply(answer[:-2])
    assert found is not None, "the literal bytes carry a wrong sum"
    return found


@pytest.mark.parametrize(
    ("command", "scan"),
    [
        (b"MD0044004701000\n", b"MD0044004701000\n99b\n0038;\n007007007007L\n\n"),
        (b"MS0044004701000\n", b"MS0044004701000\n99b\n0038;\n07070707L\n\n"),
        (b"ME0044004501000\n", b"ME0044004501000\n99b\n0038;\n0070@D0070@EG\n\n"),
        (b"MD0044004701005\n", b"MD0044004701004\n99b\n0038;\n007007007007L\n\n"),
        (b"MD0044004701001\n", b"MD0044004701000\n99b\n0038;\n007007007007L\n\n"),
    ],
)
def test_streamed_scans_are_these_bytes(command: bytes, scan: bytes) -> None:
    assert talk(command, then_s=0.2) == scan


def test_a_skipped_scan_is_not_sent() -> None:
    wire, clock = Wire(), Clock()
    device = ScipDevice(wire, clock)  # type: ignore[arg-type]
    device.receive(b"MD0044004701100\n")
    wire.sent = b""
    for tenth in range(1, 7):
        clock.time_s = 0.1 * tenth + 0.01
        device.collect()
    assert wire.sent.count(b"99b") == 3


# --- encodings, written out ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("characters", "text", "numbers"),
    [
        (2, b"00", [0]), (2, b"oo", [4095]), (2, b"CB", [1234]), (2, b"0107", [1, 7]),
        (3, b"000", [0]), (3, b"ooo", [262143]), (3, b"1Dh", [5432]),
        (4, b"0000", [0]), (4, b"oooo", [16777215]), (4, b"m2@0", [16000000]), (4, b"0038", [200]),
    ],
)  # fmt: skip
def test_characters_are_six_bits_each(characters: int, text: bytes, numbers: list[int]) -> None:
    decoded = decode((text,), characters)
    assert decoded is not None
    assert decoded.tolist() == numbers


@pytest.mark.parametrize("characters", [2, 3, 4])
@pytest.mark.parametrize("cut", range(1, 12))
def test_a_number_that_straddles_lines_is_put_together(characters: int, cut: int) -> None:
    """Twelve characters hold six, four or three numbers, cut after any of them."""
    text = b"0123456789:;"
    whole, parts = decode((text,), characters), decode((text[:cut], text[cut:]), characters)
    assert whole is not None
    assert parts is not None
    assert parts.tolist() == whole.tolist()
    assert len(whole) == 12 // characters


def test_a_line_of_64_characters_ends_in_the_middle_of_a_number() -> None:
    """22 numbers of 3 characters are 66: the first line holds 21 of them and one character."""
    said = talk(b"BM\n", b"GD0044006501\n", at_s=0.2)[len(b"BM\n00P\n\n") :]
    lines = said.split(b"\n")
    assert [len(line) for line in lines[3:5]] == [65, 3]
    assert lines[3][:64].startswith(b"007" * 10)
    (reply,) = ReplyReader().feed(said)
    ranges = decode(reply.lines[1:], 3)
    assert ranges is not None
    assert len(ranges) == 22
    assert ranges[:10].tolist() == [7] * 10
    assert np.all(ranges[10:] > 1500)


def test_a_carriage_return_ends_a_command_too() -> None:
    assert talk(b"QT\r") == b"QT\n00P\n\n"


# --- the driver on scans and answers that come at the wrong time ------------------------------------------------------


def streaming_driver() -> ScipScanner:
    """As after ``start`` with a device of five steps, without a line."""
    scanner = ScipScanner(SerialSettings("none", 115_200), ScipSettings(), NullSink(), MonotonicClock())
    scanner._geometry = ScipGeometry("", 20, 5600, 1024, 382, 386, 384, 600)
    return scanner


def scan_at(stamp: bytes) -> bytes:
    """Five ranges of 1000 mm (0x3E8: 0, 15, 40) with this time stamp and its sum."""
    return b"MD0382038601000\n99b\n" + stamp + b"\n" + b"0?X0?X0?X0?X0?XS\n\n"


def test_a_scan_that_comes_again_and_yesterdays_are_counted_and_not_handed_on() -> None:
    scanner = streaming_driver()
    for stamp in (b"00A0A", b"00BPb", b"00BPb", b"00A0A", b"00D@T"):  # 1088, 1184, 1184, 1088, 1296 ms
        scanner._on_bytes(scan_at(stamp), 0)
    profiles = scanner.take()
    assert [profile.device_time_s for profile in profiles] == pytest.approx([1.088, 1.184, 1.296])
    np.testing.assert_allclose(np.linalg.norm(profiles[0].points, axis=1), np.ones(5))
    counters = dict(scanner.health().counters)
    assert (counters["stale"], counters["bad_checksum"]) == (2, 0)


def test_an_answer_to_a_question_that_was_given_up_is_counted_as_late() -> None:
    scanner = streaming_driver()
    scanner._on_bytes(b"BM\n00P\n\n", 0)
    with pytest.raises(LinkLostError, match="not open"):
        scanner.ask("QT")
    assert dict(scanner.health().counters)["late"] == 1
