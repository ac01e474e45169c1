"""What can go wrong between portdock and a device: one root, four kinds, each with its remedy."""

from __future__ import annotations

from typing import ClassVar

from perception.errors import PortdockError


class DriverError(PortdockError):
    """Something between portdock and a device went wrong."""

    code: ClassVar[str] = "driver"
    default_remedy: ClassVar[str] = "Check the device's cable, power and settings."


class LinkOpenError(DriverError):
    """A link could not be opened (exit code 3): no such device, taken, no answer."""

    code = "link-open"
    default_remedy = "Check that the device is connected, powered and named correctly in the configuration."


class LinkLostError(DriverError):
    """A link that was open went silent or broke."""

    code = "link-lost"
    default_remedy = "Check cable and power of the device, then reset."


class ProtocolError(DriverError):
    """A device answered in a way its protocol does not allow."""

    code = "protocol"
    default_remedy = "Check that the configured protocol and baud rate are the device's own."


class CommandRejectedError(DriverError):
    """A device understood a command and refused it, or a command is not valid for this device."""

    code = "command-rejected"
    default_remedy = "See the device's own message above."
