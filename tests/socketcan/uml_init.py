"""The first process of the user-mode Linux: makes CAN, runs pytest, writes its exit status down, powers off.

Started by ``run_in_uml.py`` as the kernel's init; the root file system is the host's own. Needs neither kmod nor udev.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path

MODULES = (
    "net/can/can.ko",
    "net/can/can-raw.ko",
    "net/can/can-bcm.ko",
    "net/can/can-gw.ko",
    "drivers/net/can/dev/can-dev.ko",
    "drivers/net/can/vcan.ko",
    "drivers/net/can/slcan/slcan.ko",
)
FINIT_MODULE = 313
"""System call number on x86-64."""
RECEIVE_BYTES = 8 << 20
"""Of each socket. A process that this kernel lets wait for ten seconds would lose frames in between, and frames with
counters that jump look like those of two chargers."""
LIBC = ctypes.CDLL(None, use_errno=True)


def main() -> None:
    """Never returns: power goes off."""
    job = json.loads(Path(sys.argv[1]).read_text())
    status = 1
    try:
        _mount()
        _insert(Path(job["modules"]))
        Path("/proc/sys/net/core/rmem_default").write_text(str(RECEIVE_BYTES))
        for command in ("link set lo up", "link add dev vcan0 type vcan", "link set vcan0 mtu 72", "link set vcan0 up"):
            subprocess.run(["ip", *command.split()], check=True)
        environment = {**os.environ, **job["environment"]}
        status = subprocess.run(job["command"], cwd=job["folder"], env=environment, check=False).returncode
    finally:
        Path(job["status"]).write_text(str(status))
        os.sync()
        Path("/proc/sysrq-trigger").write_text("o")


def _mount() -> None:
    for kind, where in (
        ("proc", "/proc"),
        ("sysfs", "/sys"),
        ("devpts", "/dev/pts"),
        ("tmpfs", "/dev/shm"),
        ("tmpfs", "/run"),
    ):
        Path(where).mkdir(exist_ok=True)
        if LIBC.mount(kind.encode(), where.encode(), kind.encode(), 0, None) != 0:
            raise OSError(ctypes.get_errno(), f"mount {kind} on {where}")


def _insert(folder: Path) -> None:
    for name in MODULES:
        descriptor = os.open(folder / name, os.O_RDONLY | os.O_CLOEXEC)
        if LIBC.syscall(FINIT_MODULE, descriptor, b"", 0) != 0:
            raise OSError(ctypes.get_errno(), f"module {name}")
        os.close(descriptor)


if __name__ == "__main__":
    main()
