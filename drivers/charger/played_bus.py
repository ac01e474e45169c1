"""A CAN link that plays recorded frames: what came over the bus goes through the real decoding once more."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import can

from drivers.base import ByteSink, CanFrame, Clock
from drivers.charger.bus_link import BusLink
from drivers.charger.bus_open import Filter
from drivers.charger.settings import CanSettings
from drivers.playback import Playback


class PlayedBus(BusLink):
    """Data frames as they were received. What is sent goes nowhere."""

    def __init__(
        self,
        settings: CanSettings,
        clock: Clock,
        sink: ByteSink,
        receive: Callable[[CanFrame], None],
        filters: list[Filter] | None,
        fd: bool,
        playback: Playback,
        frames: Sequence[CanFrame],
        early_s: float,
    ) -> None:
        """``early_s``: frames up to this time are heard when the link is opened, as if the bus had been on before."""
        super().__init__(settings, clock, sink, receive, filters, fd)
        wanted = [f for f in frames if f.direction == "rx" and not f.is_error and self._passes(f)]
        self._early = [frame for frame in wanted if frame.time_s <= early_s]
        playback.play((f.time_s, lambda f=f: receive(f)) for f in wanted[len(self._early) :])  # type: ignore[misc]

    def open(self) -> None:
        """Hear what was there before the mission began."""
        for frame in self._early:
            self._receive(frame)
        self._early = []

    def close(self) -> None:
        """Nothing to close."""

    def send(self, messages: list[can.Message]) -> None:
        """Nobody listens."""

    def _passes(self, frame: CanFrame) -> bool:
        return self._filters is None or (frame.arbitration_id, frame.is_extended) in self._filters
