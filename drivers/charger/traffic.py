"""Listening to the charger's bus: every message of the contract decoded, with the health of each. Sends nothing."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import can

from drivers.base import CanFrame, Clock, LinkLostError
from drivers.charger.bus_open import close_bus, open_bus
from drivers.charger.candump import read_candump
from drivers.charger.contract import Codec, Contract, FrameError
from drivers.charger.e2e import Receiver, Verdict
from drivers.charger.settings import CanSettings
from perception.errors import InputError

_RECENT = 20


@dataclass(frozen=True, slots=True)
class MessageHealth:
    """How one message of the contract has been received so far."""

    name: str
    identifier: int
    frames: int
    accepted: int
    bad_checksum: int
    repeated: int
    wrong_sequence: int
    missed: int
    unreadable: int
    cycle_s: float
    period_s: float | None
    """Mean distance of the last frames; None before the second."""
    last_s: float | None
    values: tuple[tuple[str, str], ...]
    """Signal and value of the newest frame, as the DBC words them."""
    suspicion: str
    state: str
    """Good, late, lost, ..., as one would say it."""


@dataclass(slots=True)
class _Ear:
    codec: Codec
    receiver: Receiver
    times_s: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT))
    values: tuple[tuple[str, str], ...] = ()
    frames: int = 0
    unreadable: int = 0
    good_s: float | None = None
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=_RECENT))
    """Whether each of the last frames was in order; one that begins a sequence is."""


class CanTraffic:
    """Sorts the frames of a source by message and judges each."""

    def __init__(
        self, contract: Contract, source: Iterable[CanFrame | None], now_s: Callable[[], float] | None = None
    ) -> None:
        """``now_s``: the time of a live source; a recording's is that of its newest frame."""
        self._source, self._newest_s = source, float("-inf")
        self._now_s = now_s or (lambda: self._newest_s)
        self._ears = {codec.arbitration_id: _Ear(codec, Receiver(codec.protection)) for codec in contract.codecs}
        self.foreign = 0
        self.errors = 0

    def listen(self) -> Iterator[None]:
        """Take frame after frame until the source ends; yields after each, and when nothing came for a moment."""
        for frame in self._source:
            if frame is not None:
                self.take(frame)
            yield None

    def take(self, frame: CanFrame) -> None:
        """Count one frame of the bus."""
        ear = self._ears.get(frame.arbitration_id)
        self._newest_s = max(self._newest_s, frame.time_s)
        if frame.is_error:
            self.errors += 1
        elif ear is None or ear.codec.is_extended != frame.is_extended:
            self.foreign += 1
        else:
            _hear(ear, frame)

    def health(self) -> list[MessageHealth]:
        """One entry for each message of the contract, in the DBC's order."""
        return [_health(ear, self._now_s()) for ear in self._ears.values()]


def _hear(ear: _Ear, frame: CanFrame) -> None:
    ear.frames += 1
    try:
        values = ear.codec.decode(frame.data)
    except FrameError:
        ear.unreadable += 1
        ear.recent.append(False)
        return
    ear.times_s.append(frame.time_s)
    verdict = ear.receiver.check(frame.data, int(values.get("Counter", 0)))
    ear.recent.append(verdict.accepted or verdict is Verdict.INITIAL)
    if verdict.accepted:
        ear.good_s = frame.time_s
    ear.values = ear.codec.words(frame.data)


def _state(ear: _Ear, now_s: float) -> str:
    late_s, lost_s = ear.codec.silences_s
    if ear.frames == 0:
        return "never heard"
    if ear.good_s is None:
        return "no good frame"
    silence_s = now_s - ear.good_s
    if silence_s > lost_s:
        return "not being sent" if ear.codec.pauses else f"lost for {silence_s:.1f} s"
    if not all(ear.recent):
        return f"{ear.recent.count(False)} of {len(ear.recent)} bad"
    return "late" if silence_s > late_s else "good"


def _health(ear: _Ear, now_s: float) -> MessageHealth:
    counts, times_s = ear.receiver.counts, ear.times_s
    return MessageHealth(
        name=ear.codec.name,
        identifier=ear.codec.arbitration_id,
        frames=ear.frames,
        accepted=counts[Verdict.OK] + counts[Verdict.LOST],
        bad_checksum=counts[Verdict.BAD_CRC],
        repeated=counts[Verdict.REPEATED],
        wrong_sequence=counts[Verdict.WRONG_SEQUENCE],
        missed=ear.receiver.missed,
        unreadable=ear.unreadable,
        cycle_s=ear.codec.cycle_s,
        period_s=(times_s[-1] - times_s[0]) / (len(times_s) - 1) if len(times_s) > 1 else None,
        last_s=times_s[-1] if times_s else None,
        values=ear.values,
        suspicion=ear.receiver.suspicion,
        state=_state(ear, now_s),
    )


def listen_to_bus(settings: CanSettings, clock: Clock, seconds: float | None, fd: bool) -> Iterator[CanFrame | None]:
    """Frames of a live bus, listening only where the interface can; None whenever it was quiet for a moment.

    Raises LinkOpenError and LinkLostError. Ends after ``seconds``, or never.
    """
    bus = open_bus(settings, fd, listen_only=True)
    end_s = float("inf") if seconds is None else clock.now_s() + seconds
    try:
        while clock.now_s() < end_s:
            message = bus.recv(0.1)
            yield None if message is None else _frame(message, clock.now_s())
    except (can.CanError, OSError) as error:
        raise LinkLostError(f"the CAN bus {settings.channel} is gone: {' '.join(str(error).split())}") from error
    finally:
        close_bus(bus)


def listen_to_file(path: Path) -> Iterator[CanFrame]:
    """Frames of a recording that python-can reads: candump's .log, .blf, .asc. Raises InputError."""
    try:
        if path.suffix == ".log":
            yield from read_candump(path)
            return
        with can.LogReader(path) as reader:
            for message in reader:
                yield _frame(message, message.timestamp)
    except (OSError, ValueError, LookupError, can.CanError) as error:
        raise InputError(f"{path} cannot be read as CAN traffic: {' '.join(str(error).split())}") from error


def _frame(message: can.Message, time_s: float) -> CanFrame:
    return CanFrame(
        time_s=time_s,
        direction="rx" if message.is_rx else "tx",
        arbitration_id=message.arbitration_id,
        data=bytes(message.data),
        is_extended=message.is_extended_id,
        is_error=message.is_error_frame,
        is_fd=message.is_fd,
    )
