"""A scanner's serial line: opening it, one reader thread, writing.

The thread does nothing but ``select``, one ``os.read`` of whatever has come, and a time stamp: pyserial's own ``read``
one byte at a time cannot keep up with 500,000 baud, and a read with a time-out adds it to the latency. The chunk
goes to the recorder as it was read, then to the owner. The thread decides nothing; when the line breaks it ends and
says why.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import serial

from drivers.base import ByteSink, LinkLostError, LinkOpenError

logger = logging.getLogger(__name__)

CHUNK_BYTES = 65536
OnBytes = Callable[[bytes, int], None]
"""Told a chunk and the host's monotonic ns at which it was read."""


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """How to open the line. ``device`` is a stable name: under /dev/serial/by-id, or a symlink to a mock's pty."""

    device: str
    baud_rate: int
    parity: str = "N"
    stop_bits: int = 1
    write_timeout_s: float = 1.0
    low_latency: bool = True
    """Ask the adapter not to collect bytes for up to 16 ms (FTDI); devices that cannot are used as they are."""


class SerialLink:
    """One open serial line with its reader thread. ``on_bytes(chunk, host_time_ns)`` is called on that thread."""

    def __init__(self, settings: SerialSettings, sink: ByteSink, on_bytes: OnBytes) -> None:
        self._settings = settings
        self._sink = sink
        self._on_bytes = on_bytes
        self._port: serial.Serial | None = None
        self._thread: threading.Thread | None = None
        self._wake_read, self._wake_write = -1, -1
        self._lost: str | None = None

    @property
    def lost(self) -> str | None:
        """Why the line broke, in words; None while it has not."""
        return self._lost

    @property
    def is_open(self) -> bool:
        """Whether the line was opened, not closed since, and is not broken."""
        return self._port is not None and self._lost is None

    @property
    def may_answer(self) -> bool:
        """Whether it makes sense to go on waiting for an answer."""
        return self.is_open

    def open(self) -> None:
        """Open the device and start reading. Raises LinkOpenError; does nothing if already open."""
        if self._port is not None:
            return
        self._lost = None
        self._port = _open_port(self._settings)
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._run, args=(self._port.fileno(),), name="scanner-rx", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, close the device. Idempotent, never raises."""
        if self._port is None:
            return
        os.write(self._wake_write, b"x")
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=5.0)
        os.close(self._wake_read)
        os.close(self._wake_write)
        try:
            self._port.close()
        except OSError as error:
            logger.debug("closing %s: %s", self._settings.device, error)
        self._port, self._thread = None, None

    def write(self, data: bytes) -> None:
        """Send ``data``. Raises LinkLostError if the line is not open, broke, or takes no byte within the time-out."""
        if self._port is None or self._lost is not None:
            raise LinkLostError(f"scanner line {self._settings.device} is {self._lost or 'not open'}")
        self._sink.scanner_bytes("tx", data, time.monotonic_ns())
        try:
            self._port.write(data)
        except OSError as error:  # SerialException and SerialTimeoutException are OSErrors
            self._break(f"broken while writing: {error}")
            raise LinkLostError(f"scanner line {self._settings.device} {self._lost}") from error

    def _run(self, descriptor: int) -> None:
        try:
            while True:
                ready, _, _ = select.select([descriptor, self._wake_read], [], [])
                if self._wake_read in ready:
                    return
                chunk = os.read(descriptor, CHUNK_BYTES)
                now_ns = time.monotonic_ns()
                if not chunk:
                    self._break("gone: end of file")
                    return
                self._sink.scanner_bytes("rx", chunk, now_ns)
                self._on_bytes(chunk, now_ns)
        except OSError as error:  # EIO: unplugged
            self._break(f"gone: {error.strerror or error}")
        except Exception:  # a defect must show as a lost link, not as silence
            logger.exception("reader of %s failed", self._settings.device)
            self._break("closed by an internal error of its reader, see the log")

    def _break(self, reason: str) -> None:
        if self._lost is None:
            self._lost = reason
            logger.warning("scanner line %s %s", self._settings.device, reason)


def _open_port(settings: SerialSettings) -> serial.Serial:
    try:
        port = serial.Serial(
            settings.device,
            settings.baud_rate,
            parity=settings.parity,
            stopbits=settings.stop_bits,
            timeout=0,
            write_timeout=settings.write_timeout_s,
            exclusive=True,
        )
    except (OSError, ValueError) as error:
        raise _open_error(settings, error) from error
    if settings.low_latency:
        try:
            port.set_low_latency_mode(True)
        except (OSError, ValueError, AttributeError) as error:
            logger.debug("no low-latency mode on %s: %s", settings.device, error)
    return port


def _open_error(settings: SerialSettings, error: Exception) -> LinkOpenError:
    number = getattr(error, "errno", None)
    device = settings.device
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.ENOTDIR):
        return LinkOpenError(
            f"no serial device {device}",
            remedy="Plug the scanner in and configure its name under /dev/serial/by-id (ls /dev/serial/by-id).",
        )
    if number in (errno.EAGAIN, errno.EBUSY):
        return LinkOpenError(
            f"serial device {device} is in use by another program",
            remedy=f"Find it with: fuser -v {device}; stop it, then try again.",
        )
    if number in (errno.EACCES, errno.EPERM):
        return LinkOpenError(
            f"no permission to open serial device {device}",
            remedy="Add this user to the group of the device (often dialout) and log in again.",
        )
    if isinstance(error, ValueError):
        return LinkOpenError(
            f"serial device {device} refuses the settings: {error}",
            remedy="Use a baud rate, parity and number of stop bits that the adapter supports.",
        )
    return LinkOpenError(f"serial device {device} cannot be opened: {_first_line(error)}")


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


Connect = Callable[[SerialSettings, ByteSink, OnBytes], SerialLink]
"""Makes a line that is not open yet: a real one, or one that plays a recording."""
