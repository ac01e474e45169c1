"""Opening and closing a bus of python-can, whatever its interface: options, claims, and errors in words."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
from typing import Any

import can

from drivers.base import LinkOpenError
from drivers.charger.bus_errors import open_error
from drivers.charger.kernel_link import check_bit_rate, read_kernel_link
from drivers.charger.settings import CanSettings

_log = logging.getLogger(__name__)

READ_TIMEOUT_S = 0.05
Filter = tuple[int, bool]
"""Identifier and whether it is extended."""


def open_bus(
    settings: CanSettings, fd: bool = False, filters: list[Filter] | None = None, listen_only: bool = False
) -> Any:
    """A ``can.Bus`` that gets only the frames of ``filters`` (None: all). Raises LinkOpenError."""
    if settings.interface == "slcan":
        _refuse_taken(settings)
    elif settings.interface == "socketcan":
        _refuse_ill_set_up(settings)
    try:
        bus = can.Bus(
            channel=settings.channel,
            interface=settings.interface,
            can_filters=None if filters is None else [_filter(*one) for one in filters],
            ignore_config=True,
            receive_own_messages=False,
            **_options(settings, fd, listen_only),
        )
    except Exception as error:  # python-can lets its back-ends' own exceptions through
        raise open_error(error, settings) from error
    _claim(bus, settings)
    return bus


def close_bus(bus: Any) -> None:
    """Close a bus, also one whose adapter is gone."""
    if bus is None:
        return
    with contextlib.suppress(Exception):  # an adapter that is gone cannot be told to close
        bus.shutdown()
    port = getattr(bus, "serialPortOrig", None)
    if port is not None:
        with contextlib.suppress(OSError):
            port.close()


def _filter(identifier: int, extended: bool) -> Any:
    return {"can_id": identifier, "can_mask": 0x1FFFFFFF if extended else 0x7FF, "extended": extended}


def _options(settings: CanSettings, fd: bool, listen_only: bool) -> dict[str, Any]:
    """What an interface takes beside its channel. SocketCAN's bit rates are set with `ip link`, not here."""
    match settings.interface:
        case "socketcan":
            return {"fd": True} if fd else {}
        case "virtual":
            return {"protocol": can.CanProtocol.CAN_FD} if fd else {}
        case "slcan":
            serial = {
                "tty_baudrate": settings.tty_baudrate,
                "sleep_after_open": settings.sleep_after_open_s,
                "timeout": READ_TIMEOUT_S,
                "listen_only": listen_only,
            }
            return serial | ({"timing": _timing(settings)} if fd else {"bitrate": settings.bitrate})
        case _:
            rates = {"data_bitrate": settings.fd_data_bitrate, "fd": True} if fd else {}
            return rates | {"bitrate": settings.bitrate}


def _timing(settings: CanSettings) -> can.BitTimingFd:
    """slcan takes only the two rates out of it."""
    return can.BitTimingFd.from_sample_point(
        f_clock=80_000_000,
        nom_bitrate=settings.bitrate,
        nom_sample_point=80.0,
        data_bitrate=settings.fd_data_bitrate,
        data_sample_point=80.0,
    )


def _refuse_taken(settings: CanSettings) -> None:
    """A tty that another process has claimed is left alone: even opening the adapter would close its channel."""
    try:
        descriptor = os.open(settings.channel.split("@")[0], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return  # opening the bus says why in its own words
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise LinkOpenError(
            f"the CAN adapter at {settings.channel} is taken by another process",
            remedy="Stop the other program that has it open.",
        ) from None
    finally:
        os.close(descriptor)


def _refuse_ill_set_up(settings: CanSettings) -> None:
    """An interface at another bit rate would only disturb the bus; a kernel that cannot be asked is taken as it is."""
    try:
        link = read_kernel_link(settings.channel)
    except LinkOpenError as error:
        _log.debug("the kernel's word on %s: %s", settings.channel, error)
        return  # opening the bus says why in its own words
    if link.is_can:
        check_bit_rate(link, settings.bitrate)
        if not link.is_virtual and link.restart_ms == 0:
            _log.warning("%s will not restart after bus-off: ip link set ... restart-ms 100", settings.channel)


def _claim(bus: Any, settings: CanSettings) -> None:
    """slcan: nobody else may open the tty from now on; two readers would share its bytes."""
    port = getattr(bus, "serialPortOrig", None)
    if port is None:
        return
    try:
        port.exclusive = True
    except OSError as error:
        close_bus(bus)
        raise open_error(error, settings) from error
