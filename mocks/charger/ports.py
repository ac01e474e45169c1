"""Where the mock bus can be reached: slcan adapters on ptys, or any bus of python-can."""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path
from typing import Any, Protocol

import can

from mocks.charger.frames import BusFrame
from mocks.charger.lawicel import Lawicel


class BusPort(Protocol):
    """One connection to the bus."""

    def descriptor(self) -> int | None:
        """What to wait on for reading; None if there is nothing to wait on and it must be polled."""

    def receive(self) -> list[BusFrame]:
        """Frames that came in; never blocks."""

    def send(self, frame: BusFrame) -> None:
        """Hand a frame out; dropped when nobody takes it."""

    def close(self) -> None: ...


class SlcanPort:
    """A slcan adapter on a pty behind a symlink that stays when the adapter is pulled and plugged in again."""

    def __init__(self, link: Path, bit_rate: int) -> None:
        self._link, self._bit_rate = link, bit_rate
        self._master = self._slave = -1
        self.dropped = 0
        self.plug_in()

    def plug_in(self) -> None:
        """A new pty behind the link."""
        if self._master >= 0:
            return
        self._adapter = Lawicel(self._bit_rate)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # and the slave stays open: between clients the master would read EIO
        os.set_blocking(self._master, False)
        fresh = self._link.with_name(self._link.name + ".new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(self._slave))
        fresh.replace(self._link)

    def unplug(self) -> None:
        """The tty is gone, for its client at once."""
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1
        self._link.unlink(missing_ok=True)

    close = unplug

    def descriptor(self) -> int | None:
        return self._master if self._master >= 0 else None

    def receive(self) -> list[BusFrame]:
        if self._master < 0:
            return []
        try:
            data = os.read(self._master, 65536)
        except OSError:
            return []
        answers, frames = self._adapter.feed(data)
        self.write(answers)
        return frames

    def send(self, frame: BusFrame) -> None:
        self.write(self._adapter.tell(frame))

    def write(self, data: bytes) -> None:
        """Raw bytes to the host; what its buffer does not take is lost, as in a real adapter."""
        if self._master < 0 or not data:
            return
        try:
            self.dropped += len(data) - os.write(self._master, data)
        except OSError:
            self.dropped += len(data)


class PythonCanPort:
    """A bus of python-can: virtual, socketcan, udp_multicast, ..."""

    def __init__(self, interface: str, channel: str, bit_rate: int, fd: bool = False) -> None:
        options: dict[str, Any] = {} if interface == "socketcan" else {"bitrate": bit_rate}
        if fd:
            options |= {"protocol": can.CanProtocol.CAN_FD} if interface == "virtual" else {"fd": True}
        self._bus = can.Bus(interface=interface, channel=channel, ignore_config=True, **options)

    def descriptor(self) -> int | None:
        with contextlib.suppress(NotImplementedError, can.CanError):
            return int(self._bus.fileno())
        return None

    def receive(self) -> list[BusFrame]:
        frames = []
        while (message := self._taken()) is not None:
            if not message.is_error_frame:
                frames.append(
                    BusFrame(
                        message.arbitration_id,
                        bytes(message.data),
                        message.is_extended_id,
                        message.is_remote_frame,
                        message.is_fd,
                    )
                )
        return frames

    def _taken(self) -> can.Message | None:
        try:
            return self._bus.recv(0)
        except (can.CanError, OSError, ValueError, LookupError):  # the last two: bytes that are no slcan line
            return None

    def send(self, frame: BusFrame) -> None:
        message = can.Message(
            arbitration_id=frame.identifier, data=frame.data, is_extended_id=frame.extended, is_fd=frame.fd
        )
        with contextlib.suppress(can.CanError, OSError):  # a bus that is full or down loses the frame
            self._bus.send(message)

    def close(self) -> None:
        self._bus.shutdown()
