"""A charger's control unit as a process of its own: ``python -m mocks.charger --link PATH [--world DIR]``.

The far end of the CAN wire: a slcan adapter at byte level on a pty (or several, as taps on one bus), or any bus of
python-can, and behind it the charger: states, proximity, plug lock, contactor, pre-charge and current ramp,
temperature, pilot, emergency stop, and its own watch over the robot's heartbeat. Frames are encoded from the DBC by
cantools; no code is shared with the driver. Prints one JSON line that says where it listens, then serves until
SIGTERM; control lines on standard input are described in ``mocks.charger.controls``.

Not simulated: bit timing, arbitration and bus load; error frames and bus-off (a pty has none: the kernel's slcan driver
is the place for them); the tty's baud rate; the vehicle's own protocol (ISO 15118, GB/T 27930, CHAdeMO); insulation
test; the dynamics of real power electronics; power failure of the lock.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import select
import signal
import sys
import time
from pathlib import Path
from types import FrameType

import numpy as np

from mocks.charger.controls import parse
from mocks.charger.device import MockCharger
from mocks.charger.frames import Frames
from mocks.charger.ports import BusPort, PythonCanPort, SlcanPort
from mocks.charger.world import Alone, Shared, Surroundings

_LONGEST_WAIT_S = 0.02
_POLL_S = 0.003


def main(arguments: list[str] | None = None) -> int:
    """Serve until SIGTERM."""
    options = _options(arguments)
    logging.basicConfig(level=logging.INFO if options.verbose else logging.WARNING, format="%(message)s")
    with contextlib.ExitStack() as stack:
        ports: list[BusPort] = []
        for link in options.link:
            ports.append(SlcanPort(link, options.bitrate))
        if options.interface != "slcan":
            ports.append(PythonCanPort(options.interface, options.channel, options.bitrate, options.fd))
        for port in ports:
            stack.callback(port.close)
        world: Surroundings = Shared(options.world) if options.world else Alone(options.time_scale)
        device = MockCharger(
            Frames(options.dbc, options.protection),
            ports,
            world,
            np.random.default_rng(options.seed),
            lost_s=options.lost_ms / 1000.0,
        )
        channel = options.channel if options.interface != "slcan" else str(options.link[0])
        sys.stdout.write(json.dumps({"interface": options.interface, "channel": channel}) + "\n")
        sys.stdout.flush()
        _serve(device, ports)
    return 0


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="mocks.charger", description="A charger's control unit on a mock CAN bus.")
    parser.add_argument("--link", type=Path, action="append", default=[], help="symlink to a slcan adapter's tty")
    parser.add_argument("--interface", default="slcan", help="slcan, or a python-can interface")
    parser.add_argument("--channel", default="", help="channel of the python-can interface")
    parser.add_argument("--bitrate", type=int, default=250_000)
    parser.add_argument("--fd", action="store_true", help="CAN FD, where the interface has it")
    parser.add_argument("--dbc", type=Path, default=None)
    parser.add_argument("--protection", default="e2e-p11", choices=["none", "counter", "j1850", "e2e-p11", "e2e-p5"])
    parser.add_argument("--world", type=Path, default=None, help="folder of the mocks' shared blackboard")
    parser.add_argument(
        "--time-scale", type=float, default=1.0, help="emulated seconds for each second, without a world"
    )
    parser.add_argument("--lost-ms", type=float, default=250.0, help="silence after which the robot counts as lost")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args(arguments)
    if options.interface == "slcan" and not options.link:
        parser.error("slcan needs --link PATH")
    if options.interface != "slcan" and not options.channel:
        parser.error(f"{options.interface} needs --channel")
    return options


def _serve(device: MockCharger, ports: list[BusPort]) -> None:
    stopping = False

    def stop(signum: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    wake_read, wake_write = os.pipe()
    os.set_blocking(wake_write, False)
    signal.set_wakeup_fd(wake_write)
    controls = bytearray()
    listening = not sys.stdin.closed
    while not stopping:
        due_s = device.turn(time.monotonic())
        descriptors = [port.descriptor() for port in ports]
        longest_s = _POLL_S if None in descriptors else _LONGEST_WAIT_S
        waiting: list[int] = [wake_read, *(d for d in descriptors if d is not None)]
        if listening:
            waiting.append(sys.stdin.fileno())
        ready, _, _ = select.select(waiting, [], [], min(longest_s, max(0.0, due_s - time.monotonic())))
        if listening and sys.stdin.fileno() in ready:
            chunk = os.read(sys.stdin.fileno(), 65536)
            listening = bool(chunk)
            controls += chunk
            _obey(device, controls)


def _obey(device: MockCharger, controls: bytearray) -> None:
    """Carry out every complete line."""
    while (end := controls.find(b"\n")) >= 0:
        line = controls[:end].decode(errors="replace").strip()
        del controls[: end + 1]
        if not line:
            continue
        try:
            device.control(parse(line))
        except (ValueError, TypeError) as error:
            logging.getLogger(__name__).warning("control line ignored: %s", error)


if __name__ == "__main__":
    sys.exit(main())
