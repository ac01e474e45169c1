"""How the charger's CAN link is set up: values only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.charger.e2e import Scheme


@dataclass(frozen=True, slots=True)
class CanSettings:
    """Bus, contract and time-outs. Times are wall-clock seconds: they guard hosts, not processes."""

    channel: str
    """What the interface calls its bus: a tty for slcan, a network interface for socketcan."""
    interface: str = "slcan"
    """Any of python-can's interfaces by name."""
    bitrate: int = 250_000
    fd_data_bitrate: int = 2_000_000
    """Bit rate of the data phase, where the DBC's messages are CAN FD."""
    tty_baudrate: int = 115_200
    """slcan only: baud rate of the adapter's tty."""
    dbc: Path | None = None
    """Another DBC with the same signal names; None is the bundled one, for ``e2e-p5`` the one for CAN FD."""
    protection: Scheme = Scheme.P11
    robot_address: int | None = None
    """Replaces the lowest byte of the robot's identifiers; None keeps the DBC's."""
    charger_address: int | None = None
    """Replaces the lowest byte of the charger's identifiers; None keeps the DBC's."""
    open_timeout_s: float = 3.0
    """How long ``open`` waits for the charger's first valid status."""
    degraded_s: float = 0.15
    lost_s: float = 0.25
    """Silence after which the charger counts as lost; back after ``recovery_frames`` good frames in a row."""
    recovery_frames: int = 3
    ack_timeout_s: float = 0.5
    ack_resends: int = 2
    sleep_after_open_s: float = 0.1
    """slcan only: time the adapter takes to be ready after its tty was opened."""
    reopen_first_s: float = 0.2
    reopen_max_s: float = 2.0
    """Pause before a broken bus is opened again: doubled from the first to the largest."""
    reset_silence_s: float = 2.0
    """slcan only: silence after which the adapter is set up afresh, as it may have lost its set-up; then doubled."""
