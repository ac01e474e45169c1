"""Run the SocketCAN tests on a real kernel's CAN, as an ordinary process: user-mode Linux with the host's files.

``python tests/socketcan/run_in_uml.py [pytest arguments]``. Needs Debian's package ``user-mode-linux`` (`make
setup-socketcan`), neither root nor KVM. Exit status is pytest's; 0 with a loud word when the kernel is not installed.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
TIMEOUT_S = 900
DRY_RUN = "tests/socketcan/test_dry_run_on_vcan.py"
DEFAULT_TESTS = [
    [
        "tests/socketcan",
        f"--ignore={DRY_RUN}",
        *(f"tests/contract/test_charger_{what}.py" for what in ("cycle", "requests", "other_dbc")),
    ],
    [DRY_RUN],
]
"""One boot for each: what came before takes no memory or time from the whole dry run.

The contract tests run on SocketCAN too: ``tests.contract.charger_bench`` gives each mock a vcan there.
"""


def main(arguments: list[str]) -> int:
    """Boot, test, report."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended from outside"))  # and the kernel with it
    kernel, modules = _kernel()
    if kernel is None or modules is None:
        sys.stdout.write(
            "SKIPPED: no user-mode Linux kernel with CAN modules here, so nothing ran on real SocketCAN.\n"
            "         `make setup-socketcan` installs Debian's package user-mode-linux.\n"
        )
        return 0
    statuses = []
    for tests in [arguments] if arguments else DEFAULT_TESTS:
        with tempfile.TemporaryDirectory() as scratch:
            statuses.append(_boot(kernel, modules, Path(scratch), tests))
    return max(statuses)


def _kernel() -> tuple[str | None, Path | None]:
    """Path of the kernel and of its module tree; PORTDOCK_UML names a folder into which the package was unpacked."""
    root = Path(os.environ.get("PORTDOCK_UML", "/"))
    kernel = shutil.which("linux.uml", path=f"{root / 'usr/bin'}:{os.environ.get('PATH', '')}")
    trees = sorted((root / "usr/lib/uml/modules").glob("*/kernel"))
    trees = [tree for tree in trees if (tree / "net/can/can.ko").exists()]
    return kernel, trees[-1] if trees else None


def _boot(kernel: str, modules: Path, scratch: Path, arguments: list[str]) -> int:
    job, status = scratch / "job.json", scratch / "status"
    init = scratch / "init"
    job.write_text(
        json.dumps(
            {
                "modules": str(modules),
                "folder": str(PROJECT),
                "status": str(status),
                "command": [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments],
                "environment": {
                    "PORTDOCK_IN_UML": "1",
                    "PATH": os.environ.get("PATH", ""),
                    "HOME": os.environ.get("HOME", str(scratch)),
                },
            }
        )
    )
    init.write_text(f"#!/bin/sh\nexec {sys.executable} {Path(__file__).with_name('uml_init.py')} {job}\n")
    init.chmod(0o755)
    command = [
        kernel,
        "mem=1G",
        *("root=/dev/root", "rootfstype=hostfs", "rootflags=/", "rw", f"init={init}"),
        *("con=null", "con0=fd:0,fd:1", "quiet", f"umid=portdock{os.getpid()}", f"uml_dir={scratch}"),
    ]
    # The kernel traces its processes: each system call passes from one to the other and back; on two processors each
    # would wait for the other to wake.
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True) as linux:
        try:
            linux.wait(TIMEOUT_S)
        except subprocess.TimeoutExpired:
            sys.stdout.write(f"the kernel did not finish within {TIMEOUT_S} s\n")
            return 1
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(linux.pid, signal.SIGKILL)  # its processes are processes here, and outlive it
    return int(status.read_text()) if status.exists() else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
