"""``python -m mocks.scanner --link PATH``: a scanner at byte level on a pty behind a symlink, until SIGTERM.

Prints one JSON line, ``{"device": PATH, "protocol": ..., "pid": ...}``, when it listens. What it sees (``--source``):

- ``groove``: a made-up panel, for ``scip`` and ``--preset ld19`` a made-up room; no world needed;
- ``world``: ray-cast from the mock world in ``--world DIR``. The folder holds ``world.json`` (WorldSpec.save),
  ``port_shape.json`` (WorldSpec.save_shape) and ``blackboard`` (Blackboard.create);
- any other value: the path of a recorded sweep (.npz, see mocks/scanner/sources.py).

``--recording FILE`` plays a recording's scanner bytes back as they were (mocks/scanner/recorded_line.py); a client that
asks something else than the recorded one ends the mock with exit code 1.

Faults of the line can be switched while it runs (mocks/scanner/controls.py).

SIGUSR1 pulls the plug: the symlink goes and an open client's line breaks. SIGUSR2 plugs it in again under another pty.
Without ``--baud`` the device speaks at whatever rate the client has set; with it, a client at another rate gets
garbage.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import logging
import os
import queue
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from mocks.scanner import ld19, scip
from mocks.scanner.controls import listen
from mocks.scanner.emulated_clock import EmulatedClock
from mocks.scanner.ld19 import Ld19Device
from mocks.scanner.options import read_options, reading
from mocks.scanner.paced_wire import PacedWire
from mocks.scanner.profiler2 import Profiler2Device
from mocks.scanner.pty_line import PtyLine
from mocks.scanner.recorded_line import RecordedDevice, read_conversation
from mocks.scanner.scip import ScipDevice
from mocks.scanner.server import Device, serve
from mocks.scanner.sources import GrooveSource, RecordedSource, Source
from mocks.scanner.streaming_device import StreamingDevice, StreamTiming
from mocks.scanner.turning_views import RoomView, View, WorldView
from mocks.scanner.wire_faults import FaultRates, WireFaults
from perception.errors import InputError

RATE_HZ = 70.0


def main(arguments: list[str] | None = None) -> int:
    """Run until SIGTERM, SIGINT or end of the parent's pipe. Returns the exit code: 2 with two lines for bad input."""
    try:
        return _run(read_options(arguments))
    except InputError as error:
        sys.stderr.write(f"mocks.scanner: {error.cause}\n  remedy: {error.remedy}\n")
        return 2


def _run(options: argparse.Namespace) -> int:
    """Raises InputError."""
    sys.setswitchinterval(0.0005)  # the optics' thread must not hold up the line
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(message)s")
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    rng = np.random.default_rng(options.seed)
    with reading(options.world, "a mock world's folder") if options.source == "world" else contextlib.nullcontext():
        source, clock = _source(options, rng)
    own_folder = tempfile.TemporaryDirectory(prefix="portdock-scanner-") if options.link is None else None
    link = options.link or Path(own_folder.name if own_folder else "") / "scanner"
    line = PtyLine(link)
    rates = FaultRates(options.lost, options.doubled, options.flipped, options.stall_at_s, options.stall_s)
    if options.preset == "ld19":  # it streams whether or not somebody reads: a port that is closed keeps little of it
        options.buffer_bytes = min(options.buffer_bytes, 4096)
    buffer_bytes = int(options.buffer_bytes * max(1.0, clock.scale))  # the client's wall time to react stays the same
    faults = WireFaults(rates, rng)
    listen(faults, sys.stdin)
    wire = PacedWire(line, faults, options.baud, buffer_bytes)
    timing = StreamTiming(
        options.rate_hz or RATE_HZ / max(1.0, clock.scale / 2.0),  # ray-casting must keep pace with a fast world
        options.exposure_s,
        options.latency_s,
        options.jitter_s,
        options.clock_offset_s,
        options.drift_ppm,
    )
    device = _device(options, source, wire, timing, clock, rng)
    requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
    signal.signal(signal.SIGUSR1, lambda *_: requests.put(line.unplug))
    signal.signal(signal.SIGUSR2, lambda *_: requests.put(line.plug_in))
    with reading(link, "a symlink to make, in a folder that can be written"):
        line.plug_in()
    sys.stdout.write(json.dumps({"device": str(link), "protocol": options.protocol, "pid": os.getpid()}) + "\n")
    sys.stdout.flush()
    try:
        gc.freeze()  # a collection would hold up the whole device
        serve(device, line, wire, clock, stopping, requests)
    finally:
        line.unplug()
        if own_folder is not None:
            own_folder.cleanup()
    return 1 if isinstance(device, RecordedDevice) and device.mismatch else 0


def _device(
    options: argparse.Namespace,
    source: Any,
    wire: PacedWire,
    timing: StreamTiming,
    clock: EmulatedClock,
    rng: np.random.Generator,
) -> Device:
    own_time = {"clock_offset_s": options.clock_offset_s, "ppm": options.drift_ppm}
    if options.recording is not None:
        with reading(options.recording, "a recording (.mcap) with a scanner's bytes"):
            return RecordedDevice(read_conversation(options.recording), wire, clock)
    if options.protocol == "profiler2":
        return Profiler2Device(
            source, wire, clock, reference_m=options.reference_m, address_in_words=options.address_in_words
        )
    if options.protocol == "scip":
        return ScipDevice(wire, clock, source, **own_time)
    if options.preset == "ld19":
        sight = _lidar_sight(source) if isinstance(source, WorldView) else ld19.room
        return Ld19Device(wire, clock, sight, **own_time)
    if options.trigger_output is None:
        return StreamingDevice(source, wire, timing, clock, rng)
    return StreamingDevice(source, wire, timing, clock, rng, partial(source.edges, options.trigger_output))


def _lidar_sight(view: WorldView) -> ld19.Sight:
    """A turning lidar's ranges in the world."""

    def sight(angles_deg: Sequence[float], time_s: float) -> ld19.Ranges | None:
        seen = view.at(np.radians(angles_deg), time_s)
        return None if seen is None else seen[0]

    return sight


def _source(options: argparse.Namespace, rng: np.random.Generator) -> tuple[Source | View, EmulatedClock]:
    precision = {"noise_m": options.noise_m, "systematic_m": options.systematic_m}
    if options.protocol == "scip":
        if options.source == "groove":
            return RoomView(scip.STEPS_SEEN, scip.FRONT), EmulatedClock.of_wall(options.time_scale)
        view = WorldView(options.world, scip.ANGLES_RAD, rng, coarse=options.coarse, **precision)
        return view, view.clock
    if options.source == "groove" and options.protocol == "profiler2":
        return GrooveSource(832, 0.015, options.reference_m), EmulatedClock.of_wall(options.time_scale)
    if options.preset == "ld19" and options.source == "world":
        view = WorldView(options.world, np.zeros(0), rng, coarse=False, **precision)
        return view, view.clock
    if options.source == "groove":
        return GrooveSource(), EmulatedClock.of_wall(options.time_scale)
    if options.source == "world":
        from mocks.scanner.world_source import NARROW, WorldSource  # the ray-caster takes seconds to import

        world = WorldSource(options.world, rng, NARROW if options.protocol == "profiler2" else None)
        return world, world.clock
    with reading(Path(options.source), "a recorded sweep (.npz with profile_x_m and profile_z_m)"):
        return RecordedSource(Path(options.source)), EmulatedClock.of_wall(options.time_scale)


if __name__ == "__main__":
    with contextlib.suppress(OSError):  # a device does not compete with its client for the processor
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # a profile is too small to share between threads
    for unwanted in ("open3d.ml", "open3d.visualization"):  # three seconds to import; the ray-caster needs neither
        sys.modules[unwanted] = ModuleType(unwanted)
    sys.exit(main())
