"""A scanner that streams frames of one length, described by a ``FrameFormat`` (``config/scanners/*.yaml``)."""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import dataclass

from drivers.base import ByteSink, Clock, LinkHealth, LinkLostError
from drivers.frame_format import Command, FrameFormat
from drivers.scanner.frame_parser import FrameParser
from drivers.scanner.serial_link import Connect, SerialLink, SerialSettings
from perception.scan import Profile

logger = logging.getLogger(__name__)


UNASKED_S = 0.3
"""Within this a device that streams ten times a second has sent a whole frame. A slower one, or one that waits for
triggers, is not noticed."""


@dataclass(frozen=True, slots=True)
class FramedTimeouts:
    """Wall-clock bounds of the driver's waits."""

    ack_s: float = 1.5
    """For the device's answer to start and stop; the command is sent ``attempts`` times."""
    attempts: int = 3
    silence_s: float = 1.0
    """No good frame for so long while the laser is on: the link is lost."""


class FramedScanner:
    """``drivers.base.Scanner`` for devices that stream. Profiles wait in a bounded queue; the oldest go first.

    ``Profile.time_s`` is the time at which the frame's last byte was read; exposure and wire time are still in it.
    """

    def __init__(
        self,
        settings: SerialSettings,
        layout: FrameFormat,
        sink: ByteSink,
        clock: Clock,
        timeouts: FramedTimeouts | None = None,
        *,
        queue_profiles: int = 8192,
        connect: Connect = SerialLink,
    ) -> None:
        """``connect``: what makes the line; a replay gives one that plays recorded bytes."""
        self._settings = settings
        self._layout = layout
        self._clock = clock
        self._timeouts = timeouts or FramedTimeouts()
        self._link = connect(settings, sink, self._on_bytes)
        self._parser = FrameParser(layout)
        self._profiles: deque[Profile] = deque(maxlen=queue_profiles)
        self._changed = threading.Condition()
        self._overruns = 0
        self._late = 0
        self._streaming = False
        self._laser_on = False
        """From when it is switched on until the device has acknowledged that it is off."""
        self._abandon = False
        self._last_good_s: float | None = None
        self._started_s = 0.0

    def open(self) -> None:
        """Open the line; a laser that a pulled cable or a killed process left on goes off. Raises LinkOpenError."""
        self._link.open()
        if self._laser_on or self._streams_unasked():
            self._laser_on = True
            try:
                self._command(self._layout.stop, "stop")
                self._laser_on = False
            except LinkLostError as error:
                logger.warning("the laser may still be on: %s", error)

    def _streams_unasked(self) -> bool:
        """Whether a device that has a switch sends profiles although nobody has switched it on."""
        if self._layout.stop is None or not self._link.may_answer:  # the latter: a replay's line
            return False
        counters, before = self._parser.counters, self._parser.counters.frames
        with self._changed:
            return self._changed.wait_for(lambda: counters.frames > before, timeout=UNASKED_S)

    def close(self) -> None:
        """Laser off as far as the link allows, line closed. Idempotent, never raises."""
        if self._link.is_open:
            try:
                self.stop()
            except LinkLostError as error:
                logger.warning("laser-off is not confirmed: %s", error)
        self._streaming = False
        self._link.close()

    def start(self) -> None:
        """Laser on; profiles from before are discarded. Raises LinkLostError if the device does not acknowledge."""
        with self._changed:
            self._parser.restart()
            self._profiles.clear()
        self._laser_on = True
        self._command(self._layout.start, "start")
        self._started_s = self._clock.now_s()
        self._streaming = True

    def stop(self) -> None:
        """Laser off; what was taken before can still be fetched. Raises LinkLostError if it is not acknowledged.

        Asked for again it tries once more, until the device has acknowledged it.
        """
        if not self._laser_on:
            return
        attempts = self._timeouts.attempts if self._streaming else 1
        self._streaming = False
        self._command(self._layout.stop, "stop", attempts)
        self._laser_on = False

    def take(self) -> list[Profile]:
        """Profiles since the last call. Raises LinkLostError for a broken line or a silent device with the laser on."""
        if self._link.lost is not None:
            raise LinkLostError(f"scanner line {self._settings.device} {self._link.lost}")
        silent_s = self._silent_s()
        if self._streaming and silent_s > self._timeouts.silence_s:
            raise LinkLostError(
                f"no valid profile from {self._settings.device} for {silent_s:.2f} s ({self._describe_traffic()})",
                remedy="Check the scanner's power, its baud rate and that the configured frame format is its own.",
            )
        with self._changed:
            profiles = list(self._profiles)
            self._profiles.clear()
        return profiles

    def health(self) -> LinkHealth:
        """Up: the line is open and, while the laser is on, good frames keep coming."""
        fresh = not self._streaming or self._silent_s() <= self._timeouts.silence_s
        counters = (*self._parser.counters.as_pairs(), ("late", self._late), ("overruns", self._overruns))
        detail = self._link.lost or ("" if fresh else "silent")
        return LinkHealth(self._link.is_open and fresh, self._last_good_s, counters, detail)

    def _on_bytes(self, chunk: bytes, host_time_ns: int) -> None:
        with self._changed:
            if self._abandon:
                self._abandon = False
                self._parser.abandon_partial()
            profiles = self._parser.feed(chunk, host_time_ns)
            wanted = self._laser_on  # a device without a switch streams unasked
            if profiles and wanted:
                self._last_good_s = host_time_ns * 1e-9
                room = (self._profiles.maxlen or 0) - len(self._profiles)
                self._overruns += max(0, len(profiles) - room)
                self._profiles.extend(profiles)
            self._changed.notify_all()

    def _command(self, command: Command | None, name: str, attempts: int | None = None) -> None:
        """Send a command and wait for its acknowledgement, again up to ``attempts`` times."""
        if command is None:
            return
        with self._changed:
            self._late += len(self._parser.acks)  # of commands that were given up before
            self._parser.acks.clear()
        for attempt in range(attempts or self._timeouts.attempts):
            self._link.write(command.send)
            if not command.ack or self._acknowledged(command.ack):
                return
            self._abandon = True  # an unfinished frame may hide the answer
            logger.warning("scanner did not acknowledge %s, attempt %d", name, attempt + 1)
        raise LinkLostError(
            f"the scanner on {self._settings.device} does not acknowledge {name} ({self._describe_traffic()})",
            remedy="Check the scanner's power, its baud rate and that the configured frame format is its own.",
        )

    def _acknowledged(self, ack: bytes) -> bool:
        deadline = self._clock.now_s() + self._timeouts.ack_s
        with self._changed:
            while ack not in self._parser.acks:
                left = deadline - self._clock.now_s()
                if left <= 0 or not self._link.may_answer:
                    return False
                self._changed.wait(min(left, 0.05))
            self._parser.acks.remove(ack)
        return True

    def _silent_s(self) -> float:
        return self._clock.now_s() - max(self._started_s, self._last_good_s or 0.0)

    def _describe_traffic(self) -> str:
        counters = self._parser.counters
        return f"{counters.bytes} bytes received, {counters.frames} good frames, {counters.bad_checksum} bad checksums"
