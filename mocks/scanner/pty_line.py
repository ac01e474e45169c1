"""The far end of a serial line: a pty behind a stable symlink, which stands for /dev/serial/by-id/....

A pty neither paces nor corrupts: pacing and faults are made elsewhere. What it does tell is the baud rate that the
client set, also those without a constant of their own (termios2). Not simulated: modem lines, framing and parity
errors, RS-485.
"""

from __future__ import annotations

import array
import fcntl
import os
import struct
import tty
from pathlib import Path

_TCGETS2 = 0x802C542A
_TERMIOS2 = struct.Struct("<4IB19s2I")


class PtyLine:
    """One pty whose device name is ``link``. The slave is kept open, so the line outlives its clients."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self._master, self._slave = -1, -1
        self._last_name = ""

    def plug_in(self) -> None:
        """Make a pty and point the symlink at it. Raises FileExistsError if ``link`` is something else than a link."""
        if self.plugged_in:
            return
        self._master, self._slave = os.openpty()
        if os.ttyname(self._slave) == self._last_name:  # a device that comes back does so under another name
            first = self._master, self._slave
            self._master, self._slave = os.openpty()
            for descriptor in first:
                os.close(descriptor)
        self._last_name = os.ttyname(self._slave)
        tty.setraw(self._slave)  # a new pty echoes and turns \n into \r\n
        os.set_blocking(self._master, False)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        if self.link.exists() and not self.link.is_symlink():
            raise FileExistsError(f"{self.link} exists and is not a symlink")
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(self._slave))
        fresh.replace(self.link)

    def unplug(self) -> None:
        """Remove the device: an open client sees its line break. Idempotent."""
        if self._master < 0:
            return
        if self.link.is_symlink() and os.readlink(self.link) == os.ttyname(self._slave):
            self.link.unlink()
        os.close(self._slave)
        os.close(self._master)
        self._master, self._slave = -1, -1

    @property
    def plugged_in(self) -> bool:
        """Whether there is a device."""
        return self._master >= 0

    def fileno(self) -> int:
        """The master's descriptor, for select."""
        return self._master

    def read(self) -> bytes:
        """What the client has sent; empty if nothing or no device."""
        if not self.plugged_in:
            return b""
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Bytes that found room in the client's buffer; the rest is the caller's to keep or to lose."""
        if not self.plugged_in:
            return len(data)  # onto an open end
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def client_baud(self) -> int:
        """The output speed that the client has set on the line."""
        settings = array.array("B", bytes(_TERMIOS2.size))
        fcntl.ioctl(self._master, _TCGETS2, settings)
        return int(_TERMIOS2.unpack(settings.tobytes())[-1])
