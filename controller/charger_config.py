"""The charger's section of the configuration: its CAN bus, the contract on it, and where the vehicle can be heard."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from controller.config_section import ConfigError, Section

Address = Annotated[int, Field(ge=0, le=253)] | None


class CarConfig(Section):
    """Listening to the vehicle's own protocol in the plug, a second source for whether it is being charged."""

    protocol: Literal["none", "gbt27930", "chademo"] = "none"
    """none: nobody listens."""
    interface: Literal["socketcan", "virtual"] = "socketcan"
    """python-can interface."""
    channel: str = "can1"
    """A network that was set up with `listen-only on`; one that could send is refused."""
    accept_virtual: bool = False
    """Take a network without a controller (vcan), which cannot be listen-only. For tests."""


class ChargerConfig(Section):
    """The charger on CAN."""

    interface: str = "slcan"
    """python-can interface: slcan, socketcan, virtual or any other that is installed."""
    channel: str = "/dev/serial/by-id/can-adapter"
    """The interface's channel: a serial device, or a network such as can0."""
    bitrate_bps: Annotated[int, Field(ge=10_000, le=1_000_000)] = 250_000
    """Bit rate of the bus. With socketcan the network sets it, not portdock; another one is refused."""
    fd_data_bitrate_bps: Annotated[int, Field(ge=250_000, le=8_000_000)] = 2_000_000
    """Bit rate of the data phase where the DBC's messages are CAN FD."""
    tty_baud_rate: Annotated[int, Field(ge=9600, le=12_000_000)] = 115_200
    """slcan: baud rate of the adapter's serial device."""
    dbc: str | None = None
    """A supplier's own DBC with the same signal names. None: the bundled one."""
    robot_address: Address = None
    """Source address (lowest byte of the identifiers) of the robot. None: the DBC's."""
    charger_address: Address = None
    """Source address of the charger. None: the DBC's."""
    protection: Literal["none", "counter", "j1850", "e2e-p11", "e2e-p5"] = "e2e-p11"
    """End-to-end protection of portdock's frames: counter and checksum inside the data."""
    accept_unprotected_can: bool = False
    """Must be true for `protection: none`."""
    degraded_ms: Annotated[float, Field(ge=100, le=5000)] = 150.0
    """Silence after which the charger's link counts as degraded."""
    lost_ms: Annotated[float, Field(ge=150, le=5000)] = 250.0
    """Silence after which it counts as lost."""
    ack_timeout_ms: Annotated[float, Field(ge=50, le=10_000)] = 500.0
    """A request without an acknowledgement is sent again after this, twice, and then given up."""
    car: CarConfig = CarConfig()


def check_can_protection(charger: ChargerConfig) -> str:
    """What has to be said in the status about the link's protection; empty when there is one.

    Raises ConfigError for frames without protection that nobody has accepted: nothing is started then.
    """
    if charger.protection != "none":
        return ""
    if not charger.accept_unprotected_can:
        raise ConfigError(
            "charger.protection is 'none': docking frames would be unprotected",
            remedy="Choose a protection, or set charger.accept_unprotected_can: true.",
        )
    return "frames are not protected (accept_unprotected_can)"
