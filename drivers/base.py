"""What a scanner, an arm and a charger offer, the values they speak in, and the errors they raise.

The controller knows devices only through these protocols. Drivers decide nothing: they talk to one device each, stamp
what they receive with the host's monotonic clock and hand every byte, frame and sample to a ``ByteSink``.
"""

from __future__ import annotations

from drivers.interfaces.arm import Arm, ArmState, Box, Compliance, MotionProgress, RobotMode, SafetyMode
from drivers.interfaces.car import Car, CarPhase, CarStatus
from drivers.interfaces.charger import (
    Charger,
    ChargerRequest,
    ChargerState,
    ChargerStatus,
    DockPose,
    Heartbeat,
    Pilot,
    PlugLock,
    Proximity,
    RequestResult,
    forbids_motion,
)
from drivers.interfaces.clock import Clock, MonotonicClock
from drivers.interfaces.errors import CommandRejectedError, DriverError, LinkLostError, LinkOpenError, ProtocolError
from drivers.interfaces.link import LinkHealth
from drivers.interfaces.recording import ArmCommandRecord, ByteSink, CanFrame, Direction, NullSink
from drivers.interfaces.scanner import Scanner

__all__ = [
    "Arm",
    "ArmCommandRecord",
    "ArmState",
    "Box",
    "ByteSink",
    "CanFrame",
    "Car",
    "CarPhase",
    "CarStatus",
    "Charger",
    "ChargerRequest",
    "ChargerState",
    "ChargerStatus",
    "Clock",
    "CommandRejectedError",
    "Compliance",
    "Direction",
    "DockPose",
    "DriverError",
    "Heartbeat",
    "LinkHealth",
    "LinkLostError",
    "LinkOpenError",
    "MonotonicClock",
    "MotionProgress",
    "NullSink",
    "Pilot",
    "PlugLock",
    "ProtocolError",
    "Proximity",
    "RequestResult",
    "RobotMode",
    "SafetyMode",
    "Scanner",
    "forbids_motion",
]
