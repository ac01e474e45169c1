"""What goes wrong on a CAN bus, in words: error frames by class, exceptions by what to do about them."""

from __future__ import annotations

import enum
import errno
from pathlib import Path

import can
import serial

from drivers.base import LinkOpenError
from drivers.charger.settings import CanSettings

ERROR_CLASSES = {
    0x001: "tx_timeout",
    0x002: "lost_arbitration",
    0x004: "controller_problem",
    0x008: "protocol_violation",
    0x010: "transceiver",
    0x020: "no_acknowledge",
    0x040: "bus_off",
    0x080: "bus_error",
    0x100: "restarted",
}
"""Classes of a SocketCAN error frame, from linux/can/error.h."""
BUS_OFF = "bus-off"
_CONTROLLER_PROBLEM, _BUS_OFF, _RESTARTED = 0x004, 0x040, 0x100
_PASSIVE, _WARNING, _ACTIVE_AGAIN = 0x30, 0x0C, 0x40


def error_classes(identifier: int) -> list[str]:
    """Names of the classes in an error frame's identifier."""
    return [name for bit, name in ERROR_CLASSES.items() if identifier & bit]


def bus_condition(identifier: int, data: bytes, before: str) -> str:
    """The bus's condition after an error frame; ``bus.state`` of python-can is not to be trusted for it."""
    if identifier & _BUS_OFF:
        return BUS_OFF
    if identifier & _RESTARTED:
        return ""
    if identifier & _CONTROLLER_PROBLEM and len(data) > 1:
        if data[1] & _PASSIVE:
            return "error-passive"
        if data[1] & _WARNING:
            return "error-warning"
        if data[1] & _ACTIVE_AGAIN:
            return ""
    return before


class Trouble(enum.Enum):
    """What an exception of a bus calls for."""

    FULL = "no frame gets out: nobody acknowledges, or the bus is full"
    DOWN = "the network interface is down"
    BROKEN = "the adapter is gone"


def trouble(error: Exception) -> Trouble:
    """Judge an exception of ``recv`` or ``send``: wait, wait for the interface, or open the bus again."""
    code = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if code == errno.ENOBUFS or isinstance(error.__cause__, serial.SerialTimeoutException):
        return Trouble.FULL
    return Trouble.DOWN if code == errno.ENETDOWN else Trouble.BROKEN


def is_garbage(error: Exception) -> bool:
    """Whether an exception of ``recv`` only means bytes that python-can's slcan parser cannot read."""
    parsing = (ValueError, LookupError, TypeError)
    return isinstance(error, parsing) or isinstance(error.__cause__, UnicodeDecodeError)


def open_error(error: Exception, settings: CanSettings) -> LinkOpenError:
    """One line of cause and one of remedy for a bus that cannot be opened."""
    where = f"{settings.interface} channel {settings.channel}"
    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if isinstance(error, can.CanInterfaceNotImplementedError):
        return LinkOpenError(
            f"python-can offers no CAN interface {settings.interface}: {_line(error)}",
            remedy="Name one of python-can's interfaces: slcan, socketcan, ...",
        )
    if code == errno.EAFNOSUPPORT:
        return LinkOpenError(
            f"this kernel has no SocketCAN ({where})",
            remedy="Load the kernel's can modules, or use an slcan adapter on its tty.",
        )
    if settings.interface == "slcan" and not Path(settings.channel.split("@")[0]).exists():
        return LinkOpenError(
            f"there is no CAN adapter at {settings.channel}",
            remedy="Plug the adapter in, and name it by /dev/serial/by-id/... in the configuration.",
        )
    if code in (errno.ENODEV, errno.ENXIO):
        return LinkOpenError(
            f"there is no CAN interface {settings.channel}",
            remedy="`ip link` lists the interfaces; correct the channel or bring the interface up.",
        )
    return LinkOpenError(f"the CAN bus cannot be opened ({where}): {_line(error)}")


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
