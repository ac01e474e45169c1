"""Listens to the vehicle's own protocol on a second CAN interface, and never sends: not even an acknowledgement.

The kernel must say that the interface is listen-only before it is opened, so only SocketCAN interfaces are taken. A
virtual interface, which has no controller that could acknowledge, is taken where the settings say so: for tests.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.base import ByteSink, CanFrame, CarPhase, CarStatus, Clock, LinkHealth, LinkOpenError, NullSink
from drivers.charger.bus_link import BusLink
from drivers.charger.car_chademo import Chademo
from drivers.charger.car_gbt27930 import Gbt27930
from drivers.charger.kernel_link import KernelLink, check_bit_rate, check_listen_only, read_kernel_link
from drivers.charger.settings import CanSettings


class CarProtocol(Protocol):
    """A decoder of one protocol."""

    bitrate: int
    name: str

    @property
    def counters(self) -> dict[str, int]: ...
    def take(self, identifier: int, extended: bool, data: bytes, now_s: float) -> None: ...
    def status(self, now_s: float) -> CarStatus: ...


PROTOCOLS: dict[str, Callable[[], CarProtocol]] = {"gbt27930": Gbt27930, "chademo": Chademo}


@dataclass(frozen=True, slots=True)
class CarSettings:
    """Where the vehicle's protocol can be heard."""

    protocol: str
    """gbt27930 or chademo."""
    channel: str
    interface: str = "socketcan"
    accept_virtual: bool = False
    """Take an interface without a controller (vcan, python-can's virtual). For tests only."""


class CarListener:
    """The second opinion. Never a reason to move or to stop: it only confirms, or does not."""

    def __init__(
        self,
        settings: CarSettings,
        clock: Clock,
        sink: ByteSink | None = None,
        kernel_link: Callable[[str], KernelLink] = read_kernel_link,
    ) -> None:
        self._settings, self._clock, self._kernel_link = settings, clock, kernel_link
        self._decoder = PROTOCOLS[settings.protocol]()
        self._lock = threading.Lock()
        can_settings = CanSettings(settings.channel, settings.interface, self._decoder.bitrate)
        self._link = BusLink(can_settings, clock, sink or NullSink(), self._take, None, check=self._check)

    def open(self) -> None:
        """Begin to listen. Raises LinkOpenError, also for an interface that the kernel would let send."""
        self._check()
        self._link.open()

    def _check(self) -> None:
        """Before each opening, also of an adapter that has been plugged in again."""
        settings = self._settings
        if settings.interface == "socketcan":
            link = self._kernel_link(settings.channel)
            check_listen_only(link, settings.accept_virtual)
            check_bit_rate(link, self._decoder.bitrate)
        elif not (settings.interface == "virtual" and settings.accept_virtual):
            raise LinkOpenError(
                f"{settings.interface} cannot be shown to be listen-only",
                remedy="Use a SocketCAN interface that was set up with `listen-only on`.",
            )

    def close(self) -> None:
        """Idempotent."""
        self._link.close()

    def status(self) -> CarStatus:
        """How the vehicle stands now; SILENT when nothing is heard."""
        with self._lock:
            return self._decoder.status(self._clock.now_s())

    def health(self) -> LinkHealth:
        """Heard of late, and every counter."""
        status = self.status()
        up = status.phase is not CarPhase.SILENT
        with self._lock:
            counters = dict(self._link.counters) | dict(self._decoder.counters)
        return LinkHealth(
            up=up,
            last_rx_s=status.time_s if status.time_s > 0 else None,
            counters=tuple(sorted(counters.items())),
            detail="; ".join(word for word in (status.phase.value, self._link.trouble) if word),
        )

    def _take(self, frame: CanFrame) -> None:
        with self._lock:
            self._decoder.take(frame.arbitration_id, frame.is_extended, frame.data, frame.time_s)
