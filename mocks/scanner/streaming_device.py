"""A streaming scanner: a laser that is on or off, an exposure every period, a frame on the wire for each.

Profile k is exposed at an exact emulated time; its geometry belongs to that time however late the machine that
emulates it is. A separate thread computes the profiles, so that a slow ray-cast never stalls the line. A device that
has fallen too far behind skips profiles, and the gap shows in the sequence numbers.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mocks.scanner import wide_xz
from mocks.scanner.emulated_clock import EmulatedClock
from mocks.scanner.paced_wire import PacedWire
from mocks.scanner.sources import Source

if TYPE_CHECKING:
    from perception.geometry import Array

MAX_LAG_S = 20.0
"""A computer too slow for the world's pace makes profiles late; this late, in emulated time, they are skipped."""
MAX_BACKLOG_S = 0.2
"""The device's transmit buffer, as time on the line: on a line too slow for its rate, profiles are lost, and show."""
MAX_BATCH = 8
FINISH_WALL_S = 0.3
"""How long after laser-off profiles that were exposed before it may still be computed."""
POLL_S = 0.001


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """The device's own time, and what delays its bytes. Emulated seconds."""

    rate_hz: float = 70.0
    exposure_s: float = 500e-6
    latency_s: float = 0.0
    """From the end of exposure to the first bit: processing."""
    jitter_s: float = 0.0
    """Further delay of each frame, uniform between 0 and this."""
    clock_offset_s: float = 100.0
    """What the device's clock shows at world time 0."""
    clock_drift_ppm: float = 0.0

    def device_time_s(self, time_s: float) -> float:
        """What the device's clock shows at a world time."""
        return self.clock_offset_s + time_s * (1.0 + self.clock_drift_ppm * 1e-6)


Edges = Callable[[int], Sequence[tuple[int, float]]]
"""(number, emulated time) of the trigger input's rising edges after a number."""


class StreamingDevice:
    """The wide XZ profiler behind a paced wire."""

    def __init__(
        self,
        source: Source,
        wire: PacedWire,
        timing: StreamTiming,
        clock: EmulatedClock,
        rng: np.random.Generator,
        edges: Edges | None = None,
    ) -> None:
        """``edges``: of the trigger input; without them the device runs free."""
        self._edges = edges
        self._source = source
        self._wire = wire
        self._timing = timing
        self._clock = clock
        self._rng = rng
        self._rest = b""
        self._frames: queue.Queue[tuple[float, bytes]] = queue.Queue(maxsize=64)
        self._optics: threading.Thread | None = None
        self._power_off = threading.Event()
        self._off_s = float("inf")
        self._late_answers: list[bytes] = []
        self._number = 0
        self.skipped = 0

    def receive(self, data: bytes) -> None:
        """Bytes from the client. Laser-off is acknowledged after the last profile exposed before it."""
        commands, self._rest = wide_xz.split_commands(self._rest + data)
        for command in commands:
            if command == wide_xz.LASER_OFF:
                self._off_s = min(self._off_s, self._clock.now_s())
                self._late_answers.append(wide_xz.answer(command))
            else:
                if command == wide_xz.LASER_ON:
                    self._laser_on()
                self._wire.send(wide_xz.answer(command), self._clock.now_s())

    def collect(self) -> None:
        """Hand to the wire the profiles that are ready, and the acknowledgement of laser-off once all are."""
        finished = self._optics is None or not self._optics.is_alive()
        while not self._frames.empty():
            ready_s, frame = self._frames.get_nowait()
            if self._wire.backlog_s(self._clock.now_s()) > MAX_BACKLOG_S:
                self.skipped += 1
            else:
                self._wire.send(frame, ready_s)
        if finished:
            self._optics = None
            for answer in self._late_answers:
                self._wire.send(answer, self._clock.now_s())
            self._late_answers.clear()

    def stop(self) -> None:
        """Power off: whatever has not left is gone."""
        self._power_off.set()
        if self._optics is not None:
            self._optics.join()
        self._optics = None

    def _laser_on(self) -> None:
        if self._optics is not None and self._off_s == float("inf"):
            return
        self._finish()
        self._off_s = float("inf")
        self._source.begin_sweep()
        expose = self._expose if self._edges is None else self._expose_on_edges
        self._optics = threading.Thread(target=expose, args=(self._clock.now_s(),), name="optics", daemon=True)
        self._optics.start()

    def _finish(self) -> None:
        """Laser on again before the last sweep's profiles are out: wait for them."""
        while self._optics is not None:
            self.collect()
            self._power_off.wait(POLL_S)

    def _expose(self, began_s: float) -> None:
        """Profile after profile until laser or power goes off; those already due are computed together."""
        timing, count = self._timing, 0
        while True:
            time_s = began_s + count / timing.rate_hz
            if not self._wait_until(time_s + timing.exposure_s / 2) or self._is_over(time_s):
                return
            if self._clock.now_s() - time_s > MAX_LAG_S:
                self.skipped += 1
                self._number += 1
                count += 1
                continue
            due = int((self._clock.now_s() - time_s - timing.exposure_s / 2) * timing.rate_hz) + 1
            times_s = [began_s + (count + k) / timing.rate_hz for k in range(min(due, MAX_BATCH))]
            times_s = [moment_s for moment_s in times_s if moment_s <= self._off_s]
            lines = self._source.lines(self._number, times_s)
            for line, moment_s in zip(lines, times_s, strict=False):
                self._hand_over(line, moment_s)
            count += len(lines)
            if not lines and self._power_off.wait(POLL_S):
                return

    def _expose_on_edges(self, began_s: float) -> None:
        """One profile for each rising edge of the trigger input until laser or power goes off."""
        assert self._edges is not None
        last = 0
        while not self._power_off.is_set() and not self._is_over(self._clock.now_s()):
            for number, edge_s in self._edges(last):
                time_s = edge_s + self._timing.exposure_s / 2
                if edge_s < began_s:
                    last = number
                    continue
                lines = [] if edge_s > self._off_s else self._source.lines(self._number, [time_s])
                if not lines:
                    break
                self._hand_over(lines[0], time_s)
                last = number
            self._power_off.wait(POLL_S)

    def _wait_until(self, time_s: float) -> bool:
        """Whether the time came before power or laser went off."""
        while (wait_s := time_s - self._clock.now_s()) > 0:
            if self._off_s < time_s or self._power_off.wait(min(self._clock.wall_s(wait_s), 0.02)):
                return False
        return not self._power_off.is_set()

    def _is_over(self, time_s: float) -> bool:
        """Whether the laser went off before ``time_s``, or so long ago that what was exposed is no longer awaited."""
        off_for_s = self._clock.now_s() - self._off_s
        return time_s > self._off_s or off_for_s > FINISH_WALL_S * self._clock.scale

    def _hand_over(self, line: Array, time_s: float) -> None:
        timing = self._timing
        frame = wide_xz.encode(line, self._number, timing.device_time_s(time_s))
        self._number += 1
        delay_s = timing.exposure_s / 2 + timing.latency_s + timing.jitter_s * self._rng.random()
        while not self._power_off.is_set():
            try:
                self._frames.put((time_s + delay_s, frame), timeout=0.05)
                return
            except queue.Full:
                continue
