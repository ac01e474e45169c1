"""What the kernel says of one of its CAN interfaces, read with ``ip -details -json link show``.

python-can's ``bus.state`` says "active" whatever happens, so bit rate, bus-off and the listen-only mode are asked of
the kernel itself. Reading changes nothing.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from typing import Any

from drivers.base import LinkOpenError

_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class KernelLink:
    """One network interface as the kernel has it."""

    name: str
    is_can: bool
    is_virtual: bool
    """vcan or vxcan: no controller behind it, so neither bit rate nor listen-only mode."""
    up: bool
    state: str
    """ERROR-ACTIVE, ERROR-WARNING, ERROR-PASSIVE, BUS-OFF, STOPPED; empty where there is no controller."""
    bitrate: int | None
    restart_ms: int
    """After so long the kernel restarts a controller that is bus-off; 0 is never."""
    listen_only: bool


def read_kernel_link(name: str) -> KernelLink:
    """Ask the kernel. Raises LinkOpenError for an interface that is not there, or without the program ``ip``."""
    program = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if program is None:
        raise LinkOpenError("the state of a CAN interface cannot be read", remedy="Install iproute2.")
    try:
        done = subprocess.run(
            [program, "-details", "-json", "link", "show", "dev", name],
            capture_output=True,
            check=False,
            text=True,
            timeout=_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        raise LinkOpenError(f"the kernel does not tell the state of {name}") from None
    except OSError as error:
        raise LinkOpenError(f"the state of {name} cannot be asked for: {error.strerror}") from error
    if done.returncode != 0:
        raise LinkOpenError(
            f"there is no CAN interface {name}",
            remedy="`ip link` lists the interfaces; correct the channel or bring the interface up.",
        )
    return parse_kernel_link(done.stdout)


def parse_kernel_link(text: str) -> KernelLink:
    """The output of ``ip -details -json link show dev NAME``. Raises LinkOpenError for anything else."""
    try:
        values: dict[str, Any] = json.loads(text)[0]
        about = values.get("linkinfo", {})
        data = about.get("info_data", {})
        bitrate = data.get("bittiming", {}).get("bitrate") or data.get("bittiming_bitrate")  # the latter without timing
        return KernelLink(
            name=str(values["ifname"]),
            is_can=values.get("link_type") == "can",
            is_virtual=about.get("info_kind") in ("vcan", "vxcan"),
            up="UP" in values.get("flags", []),
            state=str(data.get("state", "")),
            bitrate=None if bitrate is None else int(bitrate),
            restart_ms=int(data.get("restart_ms", 0)),
            listen_only="LISTEN-ONLY" in data.get("ctrlmode", []),
        )
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise LinkOpenError(f"the kernel's answer about a CAN interface is not understood: {error}") from error


def check_bit_rate(link: KernelLink, wanted: int) -> None:
    """Raises LinkOpenError for an interface that is down or runs at another bit rate: it would only disturb the bus."""
    if not link.up:
        raise LinkOpenError(
            f"the CAN interface {link.name} is down",
            remedy=f"ip link set {link.name} up type can bitrate {wanted} restart-ms 100",
        )
    if link.bitrate is not None and link.bitrate != wanted:
        raise LinkOpenError(
            f"the CAN interface {link.name} runs at {link.bitrate} bit/s, the configuration says {wanted}",
            remedy=f"ip link set {link.name} down; ip link set {link.name} up type can bitrate {wanted} restart-ms 100",
        )


def check_listen_only(link: KernelLink, accept_virtual: bool) -> None:
    """Raises LinkOpenError unless the kernel keeps this interface from sending, acknowledgements included."""
    if link.listen_only or (link.is_virtual and accept_virtual):
        return
    raise LinkOpenError(
        f"the CAN interface {link.name} is not listen-only: portdock would acknowledge the vehicle's frames",
        remedy=f"ip link set {link.name} down; ip link set {link.name} up type can bitrate ... listen-only on",
    )
