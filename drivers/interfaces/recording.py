"""What a recorder offers to the drivers, and the values it takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.interfaces.arm import ArmState

Direction = Literal["rx", "tx"]


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One CAN frame as it was on the wire."""

    time_s: float
    direction: Direction
    arbitration_id: int
    data: bytes
    is_extended: bool = True
    is_error: bool = False
    is_fd: bool = False


@dataclass(frozen=True, slots=True)
class ArmCommandRecord:
    """One call to the arm with its arguments and result, as ur_rtde keeps its socket to itself."""

    time_s: float
    name: str
    arguments: tuple[float, ...]
    result: str


class ByteSink(Protocol):
    """What a recorder offers to the drivers. Called from reader threads: must be quick and thread-safe."""

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None: ...
    def coarse_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None: ...
    def can_frame(self, frame: CanFrame) -> None: ...
    def arm_state(self, state: ArmState) -> None: ...
    def arm_command(self, record: ArmCommandRecord) -> None: ...


class NullSink:
    """Records nothing."""

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """Drop the bytes."""

    def coarse_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """Drop the bytes."""

    def can_frame(self, frame: CanFrame) -> None:
        """Drop the frame."""

    def arm_state(self, state: ArmState) -> None:
        """Drop the sample."""

    def arm_command(self, record: ArmCommandRecord) -> None:
        """Drop the record."""
