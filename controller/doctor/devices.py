"""The devices' links: is each there, may this user open it, is it set for low latency? Nothing is sent to a device."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import stat
from pathlib import Path

from controller.config import SiteConfig
from controller.doctor.findings import Finding, fail, ok, warn

ARM_PORTS = ((30004, "RTDE"), (29999, "dashboard"), (30002, "secondary (programs)"))
CONNECT_S = 1.0
LATENCY_MS = 1
SYS = Path("/sys")


def scanner(config: SiteConfig) -> list[Finding]:
    """The scanner's serial line, and the coarse one's."""
    first = [] if config.coarse is None else serial_device("coarse scanner", config.coarse.scanner.device)
    return [*first, *serial_device("scanner", config.scanner.device)]


def charger(config: SiteConfig) -> list[Finding]:
    """The charger's bus."""
    site = config.charger
    findings = []
    if site.interface == "socketcan":
        findings.append(network("charger", site.channel))
    elif site.interface == "slcan":
        findings += serial_device("charger", site.channel.split("@")[0])
    else:
        findings.append(ok("charger", f"python-can interface {site.interface}, channel {site.channel}: not looked at"))
    return findings


def arm(config: SiteConfig, connect_s: float = CONNECT_S) -> list[Finding]:
    """The robot's ports. Connects and hangs up."""
    findings = []
    for port, name in ARM_PORTS:
        try:
            with socket.create_connection((config.arm.host, port), timeout=connect_s):
                findings.append(ok("arm", f"{config.arm.host}:{port} ({name}) answers"))
        except OSError as error:
            reason = error.strerror or "no answer"
            fix = "Switch the robot on, check cable, arm.host and its network settings (Settings, Security, Services)."
            findings.append(fail("arm", f"{config.arm.host}:{port} ({name}): {reason}", fix))
    return findings


def serial_device(check: str, device: str, sys: Path = SYS) -> list[Finding]:
    """A tty: there, permitted, free, with low latency, under a name that stays."""
    path = Path(device)
    if not path.exists():
        fix = f"Plug it in, or set the {check}'s device; `ls /dev/serial/by-id` shows what there is."
        return [fail(check, f"{device} does not exist", fix)]
    if not stat.S_ISCHR(path.stat().st_mode):
        return [fail(check, f"{device} is not a serial device", f"Set the {check}'s device to a tty.")]
    if not os.access(path, os.R_OK | os.W_OK):
        fix = f"sudo usermod -aG {path.group()} $USER, then log in again"
        return [fail(check, f"no permission for {device}", fix)]
    if _taken(path):
        fix = f"fuser -v {device} names the process; stop it."
        return [fail(check, f"{device} is taken by another process", fix)]
    findings = [ok(check, f"{device} is there and free")]
    if device.startswith(("/dev/ttyUSB", "/dev/ttyACM")):
        findings.append(
            warn(check, f"{device} may be another device after a replug", "Use its name under /dev/serial/by-id.")
        )
    return findings + _latency(check, path.resolve(), sys)


def _taken(path: Path) -> bool:
    """Whether another process holds the lock that portdock takes too. The line itself is left as it is."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return True
    with contextlib.closing(os.fdopen(descriptor, "r+b", buffering=0)):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


def _latency(check: str, tty: Path, sys: Path) -> list[Finding]:
    """FTDI adapters hold bytes back for 16 ms unless told otherwise."""
    timer = sys / "class" / "tty" / tty.name / "device" / "latency_timer"
    try:
        value_ms = int(timer.read_text())
    except (OSError, ValueError):
        return []
    if value_ms <= LATENCY_MS:
        return [ok(check, f"latency timer {value_ms} ms")]
    return [
        warn(
            check,
            f"latency timer {value_ms} ms: profiles come late",
            f"echo {LATENCY_MS} | sudo tee {timer}; a udev rule makes it last.",
        )
    ]


def network(check: str, name: str, sys: Path = SYS) -> Finding:
    """A CAN network: there and up."""
    folder = sys / "class" / "net" / name
    if not folder.exists():
        fix = "Load the adapter's driver and check its name: `ip link`; for a test, `ip link add dev vcan0 type vcan`."
        return fail(check, f"no network {name}", fix)
    if int((folder / "flags").read_text(), 16) & 1:
        return ok(check, f"{name} is up")
    return fail(check, f"{name} is down", f"sudo ip link set {name} up type can bitrate 250000 restart-ms 100")
