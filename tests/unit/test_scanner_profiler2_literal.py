"""Every answer of the Profiler 2 that the driver knows, as literal bytes, and what the driver makes of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.base import CommandRejectedError, LinkLostError, NullSink, ProtocolError
from drivers.scanner import profiler2_codec as codec
from drivers.scanner.profiler2 import Profiler2Settings, points_of
from drivers.scanner.question_line import QuestionLine, pause_s
from drivers.scanner.serial_link import SerialSettings
from tests.unit.test_scanner_profiler2_packets import ADDRESS_ANSWER, ADDRESS_QUESTION, answers

MEASURED = bytes.fromhex("02 03 A0 17 00 00 00 00 5A 62 03 8C")  # OUT1: 0x5A62 um = 23.138 mm


class Clock:
    """Time that passes when it is waited for."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        self.time_s += 0.01
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


class Line:
    """Stands for the serial line: answers each question with the next of some scripted bytes."""

    lost = None
    is_open = may_answer = True

    def __init__(self, script: list[bytes], heard: Callable[[bytes, int], None]) -> None:
        self.script = script
        self.heard = heard
        self.asked: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.asked.append(data)
        answer = self.script.pop(0) if self.script else b""
        if answer:
            self.heard(answer, 7_000_000_000)


def asking(script: list[bytes], tolerant: bool = False, attempts: int = 3) -> tuple[QuestionLine, Line]:
    """A question line that waits five looks at its clock for an answer, and the line below it."""
    questions = QuestionLine(SerialSettings("dev", 921_600), NullSink(), Clock(), 0.05, attempts, tolerant)
    line = Line(script, questions._on_bytes)
    questions._link = line  # type: ignore[assignment]
    return questions, line


@pytest.mark.parametrize(
    ("answer", "meaning"),
    [
        ("02 00 E0 01 03 E1", "unknown command"),
        ("02 00 E0 02 03 E2", "wrong parameter"),
        ("02 00 E0 06 03 E6", "flash memory error"),
        ("02 00 E0 08 03 E8", "not possible while measuring"),
    ],
)
def test_a_refusal_is_told_with_the_devices_own_reason(answer: str, meaning: str) -> None:
    questions, line = asking([bytes.fromhex(answer)])
    with pytest.raises(CommandRejectedError, match=meaning):
        questions.ask(ADDRESS_QUESTION, 0x400B, 2)
    assert line.asked == [ADDRESS_QUESTION]


@pytest.mark.parametrize("answer", ["02 00 E0 03 03 E3", "02 00 E0 04 03 E4", "02 00 E0 05 03 E5", "02 00 E0 07 03 E7"])
def test_a_transmission_that_the_device_did_not_understand_is_sent_again(answer: str) -> None:
    questions, line = asking([bytes.fromhex(answer), ADDRESS_ANSWER])
    found = questions.ask(ADDRESS_QUESTION, 0x400B, 2)
    assert found.words.tolist() == [0x0306, 0x2000]
    assert found.host_s == 7.0
    assert line.asked == [ADDRESS_QUESTION] * 2
    assert dict(questions.counters)["timeouts"] == 1


def test_measured_values_are_32_bit_micrometres() -> None:
    questions, _ = asking([MEASURED])
    words = questions.ask(bytes.fromhex("02 01 A0 17 00 00 03 B6"), codec.MEASURED_VALUES, 3, (0,)).words
    assert (int(words[1]) << 16 | int(words[2])) * 1e-3 == pytest.approx(23.138)
    assert codec.encode(0xA017, [0, 0, 0x5A62]) == MEASURED


def test_the_mock_says_that_nothing_is_measured() -> None:
    (answer,) = answers(bytes.fromhex("02 01 A0 17 00 00 03 B6"))
    assert answer == bytes.fromhex("02 03 A0 17 00 00 7F FF FF FF 03 34")


def test_points_are_signed_micrometres_and_7fff_is_none() -> None:
    raw = np.frombuffer(bytes.fromhex("C5 68 1D 4C  00 00 00 00  3A 98 7F FF  00 24 FF DC"), ">u2").astype(np.uint16)
    points, share = points_of(raw, Profiler2Settings(reference_m=0.1))
    np.testing.assert_allclose(points, [[-0.015, 0.0925], [0.0, 0.1], [36e-6, 0.100036]], atol=1e-12)
    assert share == 0.75
    away, _ = points_of(raw, Profiler2Settings(reference_m=0.1, y_away=True))
    np.testing.assert_allclose(away[0], [-0.015, 0.1075], atol=1e-12)


def test_an_answer_that_comes_late_is_not_taken_for_the_next_one() -> None:
    """The device answers the first question only after it was given up; the second question echoes another address."""
    first = codec.encode(0x0002, [0x0306, 0x2004, 1, 2])
    second = codec.encode(0x0002, [0x0306, 0x2200, 3, 4])
    questions, _ = asking([first + second])
    found = questions.ask(b"?", 0x0002, 4, (0x0306, 0x2200))
    assert found.words.tolist() == [0x0306, 0x2200, 3, 4]
    assert dict(questions.counters)["late"] == 1


def test_silence_and_nonsense_are_told_apart() -> None:
    silent, _ = asking([b"", b""], attempts=2)
    with pytest.raises(LinkLostError, match="does not answer"):
        silent.ask(ADDRESS_QUESTION, 0x400B, 2)
    babbling, _ = asking([MEASURED, MEASURED], attempts=2)
    with pytest.raises(ProtocolError, match="not what was asked"):
        babbling.ask(ADDRESS_QUESTION, 0x400B, 2)


def test_the_pause_before_a_question_is_the_manuals() -> None:
    assert [pause_s(rate) for rate in (9600, 19200, 38400, 4_000_000)] == [1.8e-3, 1.0e-3, 204e-6, 204e-6]
