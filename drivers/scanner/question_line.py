"""Question and answer on a half-duplex line: one question at a time, retried, with the pause that the device needs."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass

from drivers.base import ByteSink, Clock, CommandRejectedError, LinkLostError, ProtocolError
from drivers.scanner import profiler2_codec as codec
from drivers.scanner.profiler2_codec import Packet, PacketReader, Words
from drivers.scanner.serial_link import Connect, SerialLink, SerialSettings

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What the device said, and when its last byte was read."""

    words: Words
    host_s: float


class QuestionLine:
    """A Profiler 2's line: sends packets, matches answers by command, length and echoed address."""

    def __init__(
        self,
        serial: SerialSettings,
        sink: ByteSink,
        clock: Clock,
        answer_s: float,
        attempts: int,
        tolerant: bool,
        *,
        connect: Connect = SerialLink,
    ) -> None:
        self.device = serial.device
        self._clock = clock
        self._answer_s = answer_s
        self._attempts = attempts
        self._pause_s = pause_s(serial.baud_rate)
        self._reader = PacketReader(tolerant)
        self._arrived: list[tuple[Packet, float]] = []
        self._changed = threading.Condition()
        self._link = connect(serial, sink, self._on_bytes)
        self._timeouts = 0
        self._strays = 0

    @property
    def lost(self) -> str | None:
        """Why the line broke; None while it has not."""
        return self._link.lost

    @property
    def is_open(self) -> bool:
        """Whether questions can be asked."""
        return self._link.is_open

    @property
    def counters(self) -> tuple[tuple[str, int], ...]:
        """(name, count) of bytes, packets, drops, time-outs and strays (answers to no question)."""
        return (*self._reader.counters.as_pairs(), ("timeouts", self._timeouts), ("late", self._strays))

    def open(self) -> None:
        """Raises LinkOpenError."""
        self._link.open()

    def close(self) -> None:
        """Idempotent."""
        self._link.close()

    def ask(self, question: bytes, command: int, words: int | None = None, echo: tuple[int, ...] = ()) -> Answer:
        """The answer to ``question``: of this command, with so many words, the first of them as ``echo``.

        :raises LinkLostError: the line broke, or no answer came in any attempt
        :raises CommandRejectedError: the device understood and refused
        :raises ProtocolError: answers came, but none that fits
        """
        strays = self._strays
        for _ in range(self._attempts):
            self._clock.sleep(self._pause_s)
            with self._changed:
                self._reader.flush()
                self._strays += len(self._arrived)
                self._arrived.clear()
            self._link.write(question)
            answer = self._await(command, words, echo)
            if answer is not None:
                return answer
            self._timeouts += 1
        if self._strays > strays:
            raise ProtocolError(f"the scanner on {self.device} answers, but not what was asked")
        raise LinkLostError(f"the scanner on {self.device} does not answer")

    def _await(self, command: int, words: int | None, echo: tuple[int, ...]) -> Answer | None:
        """The fitting answer; None on time-out or when the device says that it did not understand the transmission."""
        deadline = self._clock.now_s() + self._answer_s
        with self._changed:
            while True:
                while self._arrived:
                    packet, host_s = self._arrived.pop(0)
                    if packet.command in codec.TRANSMISSION_ERRORS:
                        return None
                    if packet.command in codec.ERRORS:
                        raise CommandRejectedError(
                            f"the scanner refuses command {command:04x}: {codec.ERRORS[packet.command]}"
                        )
                    if _fits(packet, command, words, echo):
                        return Answer(packet.words, host_s)
                    self._strays += 1
                left_s = deadline - self._clock.now_s()
                if left_s <= 0 or not self._link.may_answer:
                    return None
                self._changed.wait(min(left_s, 0.05))

    def _on_bytes(self, chunk: bytes, host_time_ns: int) -> None:
        with self._changed:
            self._arrived += [(packet, host_time_ns * 1e-9) for packet in self._reader.feed(chunk)]
            self._changed.notify_all()


def pause_s(baud_rate: int) -> float:
    """Silence that the device wants between its answer and the next question (manual 8017035)."""
    if baud_rate <= 9600:
        return 1.8e-3
    return 1.0e-3 if baud_rate <= 19200 else 204e-6


def _fits(packet: Packet, command: int, words: int | None, echo: tuple[int, ...]) -> bool:
    if packet.command != command or (words is not None and len(packet.words) != words):
        return False
    return tuple(int(word) for word in packet.words[: len(echo)]) == echo
