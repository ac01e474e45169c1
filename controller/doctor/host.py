"""The computer: versions, disk, scheduling, clock."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np

from controller.doctor.findings import Finding, fail, ok, warn

PYTHONS = ((3, 11), (3, 12))
LIBRARIES = ("numpy", "scipy", "open3d-cpu", "pyserial", "python-can", "cantools", "ur-rtde")
LATE_WARN_S, LATE_FAIL_S = 0.005, 0.05
"""A sleep's lateness (99th percentile): the supervisor ticks each 10 ms, the robot's watchdog waits 100 ms."""


def python(version: tuple[int, int] = (sys.version_info.major, sys.version_info.minor)) -> Finding:
    """Is the interpreter one that all libraries have wheels for?"""
    text = f"Python {version[0]}.{version[1]}"
    if version in PYTHONS:
        return ok("python", text)
    return fail("python", f"{text} is not supported", "Install portdock with Python 3.11 or 3.12.")


def libraries(version_of: Callable[[str], str] = metadata.version) -> list[Finding]:
    """The libraries that a mission needs, and the one that makes it fast."""
    return [_library(name, version_of) for name in LIBRARIES] + [_compiled(version_of)]


def _library(name: str, version_of: Callable[[str], str]) -> Finding:
    try:
        return ok("library", f"{name} {version_of(name)}")
    except metadata.PackageNotFoundError:
        return fail("library", f"{name} is missing", "Install portdock again: pip install --force-reinstall portdock.")


def _compiled(version_of: Callable[[str], str]) -> Finding:
    try:
        return ok("library", f"numba {version_of('numba')}")
    except metadata.PackageNotFoundError:
        fix = "pip install 'portdock[fast]'"
        return warn("library", "numba is missing: the published method's trees run uncompiled", fix)


def disk(folder: Path, keep_mb: float) -> Finding:
    """Is there room for as many recordings as the site keeps, and may they be written?"""
    existing = folder.absolute()
    while not existing.exists():
        existing = existing.parent
    free_mb = shutil.disk_usage(existing).free / 1e6
    room = f"{free_mb:.0f} MB free for {folder}, {keep_mb:.0f} MB kept"
    if not _writable(existing):
        return fail("disk", f"{existing} cannot be written", f"Give this user the folder: chown it, or set {_KEY}.")
    if free_mb < 200:
        return fail("disk", room, f"Free some space, or set {_KEY} to a larger disk.")
    if free_mb < keep_mb:
        return warn("disk", room, "Lower recording.keep_mb, or free some space: recordings would fill the disk.")
    return ok("disk", room)


_KEY = "recording.folder"


def _writable(folder: Path) -> bool:
    probe = folder / ".portdock-doctor"
    try:
        probe.touch()
        probe.unlink()
    except OSError:
        return False
    return True


def scheduling(lateness_s: Callable[[], float] | None = None) -> Finding:
    """How late the computer wakes a thread: below what the supervisor's tick needs?"""
    late_s = (lateness_s or sleep_lateness_s)()
    text = f"99 of 100 sleeps of 10 ms end within {1000 * late_s:.1f} ms after their time"
    fix = "Stop other programs, choose the processor governor `performance`, or give portdock processors of its own."
    if late_s > LATE_FAIL_S:
        return fail("scheduling", text, fix)
    return warn("scheduling", text, fix) if late_s > LATE_WARN_S else ok("scheduling", text)


def sleep_lateness_s(sleeps: int = 100) -> float:
    """99th percentile of the lateness of sleeps of 10 ms, seconds."""
    late = []
    for _ in range(sleeps):
        start_s = time.monotonic()
        time.sleep(0.01)
        late.append(time.monotonic() - start_s - 0.01)
    return float(np.percentile(late, 99))


def governor(cpus: Path = Path("/sys/devices/system/cpu")) -> Finding:
    """Do the processors keep their speed while they wait?"""
    found = {path.read_text().strip() for path in cpus.glob("cpu*/cpufreq/scaling_governor")}
    if not found or found == {"performance"}:
        return ok("processors", f"governor {', '.join(found) or 'not adjustable here'}")
    return warn(
        "processors",
        f"governor {', '.join(sorted(found))}: the first milliseconds after a pause are slow",
        "cpupower frequency-set --governor performance",
    )


def clock(synchronised: Path = Path("/run/systemd/timesync/synchronized"), now_s: float | None = None) -> Finding:
    """Is the time of day plausible and kept? Missions run on the monotonic clock; recordings bear the time of day."""
    now_s = time.time() if now_s is None else now_s
    if now_s < 1_700_000_000:
        return fail("clock", "the time of day is years off", "Set the clock: timedatectl set-ntp true.")
    if synchronised.exists():
        return ok("clock", "kept by systemd-timesyncd")
    return warn(
        "clock",
        "not kept by systemd-timesyncd: recordings may bear a wrong time of day",
        "timedatectl set-ntp true; no need where chrony or another service keeps the clock.",
    )
