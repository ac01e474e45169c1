"""Laser range finders that speak SCIP 2 (Hokuyo URG, UTM and relatives), streaming with MD, MS or ME.

Their ranges are good to centimetres: they find where the car's port is, they do not dock. The link is taken over from
any state: whatever streams is stopped and drained before the first question.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from drivers.base import ByteSink, Clock, LinkHealth, LinkLostError, LinkOpenError
from drivers.frame_format import CounterField
from drivers.scanner import scip_codec as codec
from drivers.scanner.counters import ClockUnwrapper, SequenceTracker
from drivers.scanner.scip_codec import Reply, ReplyReader
from drivers.scanner.serial_link import Connect, SerialLink, SerialSettings
from perception.geometry import Array
from perception.scan import Profile

logger = logging.getLogger(__name__)

TIME = CounterField("time", 1 << 24, 1e-3)
"""Milliseconds in 24 bits: wraps after 4 h 39 min."""
QUIET_S = 0.14
"""So long a silence means that the device sends nothing more."""


@dataclass(frozen=True, slots=True)
class ScipSettings:
    """What to measure. Steps of None are the device's first and last."""

    first_step: int | None = None
    last_step: int | None = None
    cluster: int = 1
    """Neighbouring steps that share one value, the least of them."""
    skip: int = 0
    """Scans left out between two."""
    intensity: bool = False
    two_characters: bool = False
    """Ranges up to 4,095 mm in 12 bits: a third less on the line. Not together with intensity."""
    counter_clockwise: bool = True
    """Angles grow to the left of someone who looks out of the device with it upright."""
    answer_s: float = 1.0
    attempts: int = 3
    silence_s: float = 2.0


@dataclass(frozen=True, slots=True)
class ScipGeometry:
    """From the device's PP reply."""

    model: str
    min_range_mm: int
    max_range_mm: int
    steps_per_turn: int
    first_step: int
    last_step: int
    front_step: int
    rpm: int


class ScipScanner:
    """``drivers.base.Scanner`` for SCIP 2 devices."""

    def __init__(
        self,
        serial: SerialSettings,
        settings: ScipSettings,
        sink: ByteSink,
        clock: Clock,
        *,
        queue_profiles: int = 4096,
        connect: Connect = SerialLink,
    ) -> None:
        self._device = serial.device
        self._settings = settings
        self._clock = clock
        self._link = connect(serial, sink, self._on_bytes)
        self._reader = ReplyReader()
        self._time = ClockUnwrapper(TIME)
        self._order = SequenceTracker(TIME)
        self._changed = threading.Condition()
        self._answers: list[Reply] = []
        self._profiles: deque[Profile] = deque(maxlen=queue_profiles)
        self._geometry: ScipGeometry | None = None
        self._beams: Array | None = None
        self._streaming = False
        self._laser_on = False
        """From when it is switched on until the device has confirmed that it is off."""
        self._number = 0
        self._refused = 0
        self._late = 0
        self._last_byte_s = 0.0
        self._last_good_s: float | None = None
        self._started_s = 0.0

    @property
    def geometry(self) -> ScipGeometry:
        """What the device said of itself. Raises LinkLostError before ``open``."""
        if self._geometry is None:
            raise LinkLostError(f"scanner line {self._device} is not open")
        return self._geometry

    def open(self) -> None:
        """Open the line, stop whatever the device is doing, learn its geometry. Raises LinkOpenError."""
        self._link.open()
        try:
            self._take_over()
            self._laser_on = False
            self._geometry = geometry_of(self.ask("PP"))
        except LinkLostError as error:
            self._link.close()
            raise LinkOpenError(
                error.cause, remedy="Check power, baud rate, and that the device speaks SCIP 2."
            ) from error

    def close(self) -> None:
        """Laser off as far as the link allows, line closed. Idempotent, never raises."""
        if self._link.is_open:
            try:
                self.stop()
            except LinkLostError as error:
                logger.warning("laser-off is not confirmed: %s", error)
        self._streaming = False
        self._link.close()  # what it leaves on is switched off when it is opened again

    def start(self) -> None:
        """Laser on, scans flow. Raises LinkLostError if the device refuses.

        The geometry is asked for once more: the bytes of each sweep are then understood without those before.
        """
        self._geometry = geometry_of(self.ask("PP"))
        self._laser_on = True
        if self.ask("BM").status not in (codec.OK, "02"):
            raise LinkLostError(f"the laser of {self._device} does not come on: malfunction")
        settings = self._settings
        first, last = self._steps()
        command = f"{self._stream_code()}{first:04d}{last:04d}{settings.cluster:02d}{settings.skip:1d}00"
        with self._changed:
            self._profiles.clear()
            self._order.restart()
        reply = self.ask(command)
        if reply.status != codec.OK:
            raise LinkLostError(f"the scanner on {self._device} refuses {command}: status {reply.status}")
        self._started_s = self._clock.now_s()
        self._streaming = True

    def stop(self) -> None:
        """Laser off. Idempotent. Raises LinkLostError if the device does not confirm it."""
        if self._laser_on:
            self._streaming = False
            self.ask("QT")
            self._laser_on = False

    def take(self) -> list[Profile]:
        """Profiles since the last call. Raises LinkLostError for a broken line or a silent device."""
        if self._link.lost is not None:
            raise LinkLostError(f"scanner line {self._device} {self._link.lost}")
        if self._streaming and self._silent_s() > self._settings.silence_s:
            raise LinkLostError(f"no valid scan from {self._device} for {self._silent_s():.1f} s")
        with self._changed:
            profiles = list(self._profiles)
            self._profiles.clear()
        return profiles

    def health(self) -> LinkHealth:
        """Up: the line is open and, while streaming, scans keep coming."""
        fresh = not self._streaming or self._silent_s() <= self._settings.silence_s
        own = (("late", self._late), ("stale", self._order.stale), ("refused", self._refused))
        counters = (*self._reader.counters.as_pairs(), *own)
        return LinkHealth(self._link.is_open and fresh, self._last_good_s, counters, self._link.lost or "")

    def ask(self, command: str) -> Reply:
        """The reply to a command (VV, PP, II, TM0..2, BM, QT, RS, GD...). Raises LinkLostError if none comes."""
        for _ in range(self._settings.attempts):
            with self._changed:
                self._late += len(self._answers)  # to commands that were given up before
                self._answers.clear()
            self._link.write(command.encode("ascii") + b"\n")
            reply = self._await(command)
            if reply is not None:
                return reply
        raise LinkLostError(f"the scanner on {self._device} does not answer {command}")

    def device_time_s(self) -> float:
        """The device's clock now (TM0, TM1, TM2), 24 bits of milliseconds. Only while nothing streams."""
        self.ask("TM0")
        values = codec.decode(self.ask("TM1").lines, 4)
        self.ask("TM2")
        if values is None or len(values) != 1:
            raise LinkLostError(f"the scanner on {self._device} sends no time")
        return float(values[0]) * TIME.unit_s

    def _take_over(self) -> None:
        """From an unknown state: end an unfinished line, stop streaming, wait for silence."""
        settings = self._settings
        for _ in range(settings.attempts):
            self._link.write(b"\nQT\n")
            written_s = self._clock.now_s()
            quiet_since_s = written_s
            while self._clock.now_s() - quiet_since_s < QUIET_S and self._clock.now_s() - written_s < settings.answer_s:
                self._clock.sleep(0.01)
                quiet_since_s = max(written_s, self._last_byte_s)
            if self._clock.now_s() - quiet_since_s >= QUIET_S:
                break
        with self._changed:
            self._reader.flush()
        self.ask("QT")

    def _await(self, command: str) -> Reply | None:
        deadline = self._clock.now_s() + self._settings.answer_s
        with self._changed:
            while True:
                for reply in self._answers:
                    if reply.echo == command:
                        self._answers.remove(reply)
                        return reply
                left_s = deadline - self._clock.now_s()
                if left_s <= 0 or not self._link.may_answer:
                    return None
                self._changed.wait(min(left_s, 0.05))

    def _on_bytes(self, chunk: bytes, host_time_ns: int) -> None:
        host_s = host_time_ns * 1e-9
        with self._changed:
            self._last_byte_s = host_s
            bad = self._reader.counters.bad_checksum
            replies = self._reader.feed(chunk)
            self._number += self._reader.counters.bad_checksum - bad  # scans that are lost leave a gap
            for reply in replies:
                if reply.status == codec.STREAMING:
                    self._on_scan(reply, host_s)
                else:
                    self._answers.append(reply)
            self._changed.notify_all()

    def _on_scan(self, reply: Reply, host_s: float) -> None:
        """A streamed scan: counted always, kept if it is whole."""
        self._number += 1
        if self._geometry is None or not reply.lines or reply.echo[:2] != self._stream_code():
            self._refused += 1
            return
        ticks = codec.decode_one(reply.lines[0], 4)
        width = 2 if self._settings.two_characters else 3
        values = codec.decode(reply.lines[1:], width)
        first, last = self._steps()
        count = (last - first) // self._settings.cluster + 1
        if ticks is None or values is None or len(values) != count * (2 if self._settings.intensity else 1):
            self._refused += 1
            return
        if self._order.accept(ticks) is None:  # the same scan again, or one from before the last
            return
        device_s = self._time.seconds(ticks, host_s)
        ranges_mm = values[::2] if self._settings.intensity else values
        least, most = self.geometry.min_range_mm, self.geometry.max_range_mm
        seen = np.flatnonzero((ranges_mm >= least) & (ranges_mm <= most))  # below: error codes
        points = self._directions(count, first).take(seen, axis=0)
        points *= (ranges_mm.take(seen) * 1e-3)[:, None]
        light = values[1::2].take(seen).astype(np.float64) if self._settings.intensity else None
        self._profiles.append(Profile(self._number, host_s, device_s, points, light, len(seen) / count))
        self._last_good_s = host_s

    def _directions(self, count: int, first: int) -> Array:
        """Unit vectors (N, 2) of the beams, x and z; the same for all scans with the same steps."""
        if self._beams is None or len(self._beams) != count:
            cluster = self._settings.cluster
            step = first + cluster * np.arange(count) + (cluster - 1) / 2
            angle = (step - self.geometry.front_step) * 2 * np.pi / self.geometry.steps_per_turn
            side = -1.0 if self._settings.counter_clockwise else 1.0
            self._beams = np.stack([side * np.sin(angle), np.cos(angle)], axis=1)
        return self._beams

    def _steps(self) -> tuple[int, int]:
        first, last = self._settings.first_step, self._settings.last_step
        geometry = self.geometry
        return geometry.first_step if first is None else first, geometry.last_step if last is None else last

    def _stream_code(self) -> str:
        if self._settings.intensity:
            return "ME"
        return "MS" if self._settings.two_characters else "MD"

    def _silent_s(self) -> float:
        return self._clock.now_s() - max(self._started_s, self._last_good_s or 0.0)


def geometry_of(reply: Reply) -> ScipGeometry:
    """The geometry in a PP reply. Raises LinkLostError if a key is missing."""
    values = dict(codec.parameters(reply))
    try:
        numbers = [int(values[key]) for key in ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")]
    except (KeyError, ValueError) as error:
        raise LinkLostError(f"the scanner's parameters lack {error}") from error
    return ScipGeometry(values.get("MODL", ""), *numbers)
