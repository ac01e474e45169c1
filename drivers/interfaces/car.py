"""What the vehicle's own charging protocol says, where a site listens to it: a second opinion on the charger's word."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

from drivers.interfaces.link import LinkHealth


class CarPhase(enum.Enum):
    """How far the vehicle and its charger have come."""

    SILENT = "silent"
    """Nothing recent enough to judge by."""
    PREPARING = "preparing"
    """They talk, no current yet."""
    CHARGING = "charging"
    """The vehicle itself says that current flows into it."""
    ENDING = "ending"
    """One side has said that it ends the charging."""


@dataclass(frozen=True, slots=True)
class CarStatus:
    """The newest of what was heard of the vehicle. Numbers that were not heard are NaN."""

    time_s: float
    """Host's monotonic time of the newest message that could be decoded; -inf before the first."""
    protocol: str
    phase: CarPhase
    voltage_v: float
    current_a: float
    """Into the vehicle."""
    wanted_current_a: float
    charge_percent: float
    reason: str = ""
    """Why it ends, in the protocol's words."""


class Car(Protocol):
    """What listens to the vehicle, and never sends."""

    def open(self) -> None:
        """Raises LinkOpenError, also for an interface that the kernel would let send."""

    def close(self) -> None:
        """Idempotent."""

    def status(self) -> CarStatus:
        """How the vehicle stands now; SILENT when nothing is heard."""

    def health(self) -> LinkHealth: ...
