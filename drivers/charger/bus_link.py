"""One CAN bus that is kept open: a thread that reads, a thread that writes, and re-opening with back-off.

Neither thread decides anything. The reader hands each data frame to a callback; the writer empties a mailbox that
holds at most one frame for each identifier, so that a caller never waits for a bus that does not take frames, and a
stale frame is replaced rather than queued. Every frame goes to the recorder as it was on the wire.
"""

from __future__ import annotations

import contextlib
import logging
import termios
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Any

import can

from drivers.base import ByteSink, CanFrame, Clock, Direction, LinkOpenError
from drivers.charger.bus_errors import BUS_OFF, Trouble, bus_condition, error_classes, is_garbage, trouble
from drivers.charger.bus_open import READ_TIMEOUT_S, Filter, close_bus, open_bus
from drivers.charger.settings import CanSettings
from drivers.charger.tail import TrafficTail

_log = logging.getLogger(__name__)
_WRITE_TIMEOUT_S = 0.25
_LONGEST_PATIENCE_S = 60.0
EVIDENCE_S = 2.0
_FULL_S = 0.25
"""A queue that stays full for this long is a bus on which nobody acknowledges."""


class BusLink:
    """The bus, its two threads and its counters."""

    def __init__(
        self,
        settings: CanSettings,
        clock: Clock,
        sink: ByteSink,
        receive: Callable[[CanFrame], None],
        filters: list[Filter] | None,
        fd: bool = False,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """``receive`` gets each data frame that ``filters`` let through (None: all).

        ``check`` raises LinkOpenError where the bus must not be opened again as it is.
        """
        self._check = check
        self._settings, self._clock, self._sink, self._receive = settings, clock, sink, receive
        self._filters, self._fd = filters, fd
        self._bus: Any = None
        self._closing = threading.Event()
        self._broken = threading.Event()
        self._mail: OrderedDict[int, can.Message] = OrderedDict()
        self._mail_ready = threading.Condition()
        self._threads: list[threading.Thread] = []
        self._full_since_s = self._full_s = float("-inf")
        """When frames began to be refused, and when one was refused last."""
        self._condition = ""
        self._trouble = ""
        self._heard_s, self._patience_s = 0.0, settings.reset_silence_s
        self.counters: Counter[str] = Counter()
        self.tail = TrafficTail(EVIDENCE_S + settings.lost_s)

    @property
    def trouble(self) -> str:
        """What is wrong with the bus itself; empty when nothing is known to be."""
        return self._trouble or self._condition

    def open(self) -> None:
        """Open the bus and start both threads. Raises LinkOpenError."""
        self._closing.clear()
        self._broken.clear()
        self._heard_s, self._patience_s = self._clock.now_s(), self._settings.reset_silence_s
        self._bus = open_bus(self._settings, self._fd, self._filters)
        self._threads = [
            threading.Thread(target=self._read, name="can-read", daemon=True),
            threading.Thread(target=self._write, name="can-write", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop both threads and close the bus, once what was handed over is sent or has had time to be."""
        if self._bus is None and not self._threads:
            return
        with self._mail_ready:
            self._mail_ready.wait_for(lambda: not self._mail or self._broken.is_set(), timeout=_WRITE_TIMEOUT_S)
            self._closing.set()
            self._mail_ready.notify_all()
        for thread in self._threads:
            thread.join(timeout=2.0)
        self._threads = []
        close_bus(self._bus)
        self._bus = None

    def send(self, messages: list[can.Message]) -> None:
        """Hand frames over for sending; never waits. One that still waits is replaced by its successor."""
        with self._mail_ready:
            for message in messages:
                if self._mail.pop(message.arbitration_id, None) is not None:
                    self.counters["tx_replaced"] += 1
                self._mail[message.arbitration_id] = message
            self._mail_ready.notify_all()

    # --- reader -------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                self._read_once()
            except Exception:  # a defect shows as a broken bus, which is opened again; the thread never ends silently
                _log.exception("reading the CAN bus %s", self._settings.channel)
                self._broken.set()
                self._closing.wait(READ_TIMEOUT_S)

    def _read_once(self) -> None:
        if self._broken.is_set():
            self._reopen()
            return
        try:
            message = self._bus.recv(READ_TIMEOUT_S)
        except (can.CanError, OSError, ValueError, LookupError, TypeError) as error:
            if is_garbage(error):
                self._skip_garbage(error)
                return
            self._note_trouble("rx_errors", error)
            self._closing.wait(READ_TIMEOUT_S)
            return
        if message is not None:
            self._take(message)
        elif self._settings.interface == "slcan":
            self._reset_when_silent()

    def _reset_when_silent(self) -> None:
        """An adapter that was reset has forgotten bit rate and open channel, and says nothing about it."""
        if self._clock.now_s() - self._heard_s > self._patience_s:
            self._patience_s = min(2.0 * self._patience_s, _LONGEST_PATIENCE_S)
            self._heard_s = self._clock.now_s()
            self.counters["adapter_resets"] += 1
            self._broken.set()

    def _skip_garbage(self, error: Exception) -> None:
        self.counters["garbage"] += 1
        _log.debug("unreadable bytes from the CAN adapter: %s", error)
        flush = getattr(self._bus, "flush", None)
        if isinstance(error.__cause__, UnicodeDecodeError) and flush is not None:  # its buffer keeps the bytes else
            with contextlib.suppress(can.CanError, OSError):
                flush()

    def _take(self, message: can.Message) -> None:
        now_s = self._heard_s = self._clock.now_s()
        self._patience_s = self._settings.reset_silence_s
        frame = self._record(message, "rx", now_s)
        if message.is_error_frame:
            self.counters["error_frames"] += 1
            for name in error_classes(message.arbitration_id):
                self.counters[f"error_{name}"] += 1
            self._condition = bus_condition(message.arbitration_id, frame.data, self._condition)
        elif message.is_remote_frame:
            self.counters["remote_frames"] += 1
        else:
            self.counters["rx_frames"] += 1
            if self._trouble == Trouble.DOWN.value:
                self._trouble = ""
            if self._condition == BUS_OFF:
                self._condition = ""  # who is off the bus hears nothing
            self._receive(frame)

    def _reopen(self) -> None:
        """Close what is broken and try to open the bus again, with growing pauses, until it opens or all closes."""
        close_bus(self._bus)
        pause_s = self._settings.reopen_first_s
        while not self._closing.wait(pause_s):
            try:
                self._check()
                self._bus = open_bus(self._settings, self._fd, self._filters)
            except (
                LinkOpenError,
                OSError,
                termios.error,
            ) as error:  # the latter: an adapter that goes while it is opened
                _log.debug("CAN bus still not there: %s", error)
                pause_s = min(2.0 * pause_s, self._settings.reopen_max_s)
                continue
            self.counters["reopened"] += 1
            self._trouble = self._condition = ""
            self._broken.clear()
            _log.info("CAN bus %s is open again", self._settings.channel)
            return

    # --- writer -------------------------------------------------------------------------------------------------

    def _write(self) -> None:
        while True:
            with self._mail_ready:
                self._mail_ready.wait_for(lambda: self._mail or self._closing.is_set())
                if self._closing.is_set():
                    return
                _, message = self._mail.popitem(last=False)
                self._mail_ready.notify_all()
            if self._broken.is_set():
                self.counters["tx_dropped"] += 1
                continue
            self._put(message)

    def _put(self, message: can.Message) -> None:
        bus = self._bus
        try:
            bus.send(message, timeout=_WRITE_TIMEOUT_S)
        except (can.CanError, OSError, ValueError) as error:
            self.counters["tx_dropped"] += 1
            if bus is self._bus:
                self._note_trouble("tx_errors", error)
            return
        now_s = self._clock.now_s()
        free = now_s - self._full_s > _FULL_S  # one frame that slips through makes no free bus
        if self._trouble == Trouble.DOWN.value or (self._trouble == Trouble.FULL.value and free):
            self._trouble = ""
        self.counters["tx_frames"] += 1
        self._record(message, "tx", now_s)

    # --- both ---------------------------------------------------------------------------------------------------

    def _note_trouble(self, counter: str, error: Exception) -> None:
        self.counters[counter] += 1
        kind = trouble(error)
        if kind is Trouble.FULL:
            now_s = self._clock.now_s()
            if now_s - self._full_s > _FULL_S:
                self._full_since_s = now_s
            self._full_s = now_s
            if now_s - self._full_since_s <= _FULL_S:
                return
        if self._trouble != kind.value:
            _log.warning("CAN bus %s: %s (%s)", self._settings.channel, kind.value, error)
        self._trouble = kind.value
        if kind is Trouble.BROKEN:
            self._broken.set()

    def _record(self, message: can.Message, direction: Direction, now_s: float) -> CanFrame:
        frame = CanFrame(
            time_s=now_s,
            direction=direction,
            arbitration_id=message.arbitration_id,
            data=bytes(message.data),
            is_extended=message.is_extended_id,
            is_error=message.is_error_frame,
            is_fd=message.is_fd,
        )
        self.tail.add(frame)
        self._sink.can_frame(frame)
        return frame


Connect = Callable[[CanSettings, Clock, ByteSink, Callable[[CanFrame], None], list[Filter] | None, bool], BusLink]
"""Makes a link."""
