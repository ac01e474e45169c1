"""``portdock dry-run`` with the mock charger on a kernel interface, and with patience for a kernel in slow motion.

The same code as the command line's; only the limits of the host are wider than a site file may set them. Arguments: the
interface and channel of the charger's bus as INTERFACE:CHANNEL, and the folder for recording and report. Prints the
result as one JSON object.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

from controller.cli.dry_run import can_bus, for_mocks, profile_rate
from controller.cli.progress import make_display
from controller.config import SiteConfig, load_config
from controller.mock_cell import MockCell
from controller.port_files import load_port
from controller.scenarios import draw_scenario
from controller.session import run_session

PACE = 0.25
"""Emulated seconds per wall second: one slow processor has mocks, drivers and ray-caster to serve."""
PROFILE_RATE_HZ, SWEEP_MM_S = 20.0, 20.0
PATIENCE: dict[str, dict[str, object]] = {
    "scan": {"speed_mm_s": SWEEP_MM_S},
    "arm": {"freshness_ms": 60_000.0, "watchdog_hz": 0.02},
    "charger": {"degraded_ms": 50_000.0, "lost_ms": 60_000.0, "ack_timeout_ms": 20_000.0},
    "scanner": {"silence_ms": 60_000.0, "sync": "shared_clock"},
    "host": {"stall_ms": 60_000.0},
    "mission": {"charge_s": 2.0},
}


def patient(site: SiteConfig) -> SiteConfig:
    """Wider than the configuration's own bounds: nothing real moves."""
    changes = PATIENCE | {"deadlines": dict.fromkeys(type(site.deadlines).model_fields, 3600.0)}
    return site.model_copy(
        update={name: getattr(site, name).model_copy(update=update) for name, update in changes.items()}
    )


LOOK_S = 1.0
LAST = 19
"""Nice value."""


def put_the_arms_worker_last(done: threading.Event) -> None:
    """ur_rtde's receiver looks 10,000 times a second: on this kernel that would take the processor from all others."""
    while not done.wait(LOOK_S):
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if b"drivers.arm.ur_worker" in (process / "cmdline").read_bytes():
                    for task in (process / "task").iterdir():
                        os.setpriority(os.PRIO_PROCESS, int(task.name), LAST)


def main() -> None:
    """One mission."""
    done = threading.Event()
    threading.Thread(target=put_the_arms_worker_last, args=(done,), daemon=True).start()
    can, folder = can_bus(sys.argv[1]), Path(sys.argv[2])
    site = patient(for_mocks(load_config()))
    world = draw_scenario("nominal", site, load_port(site.port.model), 0)
    folder.mkdir(parents=True)
    with (
        make_display(quiet=True) as display,
        tempfile.TemporaryDirectory(prefix="portdock-") as wires,
        MockCell(Path(wires), site, world, 0, PACE, can, profile_rate(PROFILE_RATE_HZ)) as cell,
    ):
        summary = run_session(cell.config, folder, display, pace=PACE, heartbeat_mode=1, truth=world.T_base_port)
    done.set()
    sys.stdout.write(json.dumps(summary.to_json()) + "\n")


if __name__ == "__main__":
    main()
