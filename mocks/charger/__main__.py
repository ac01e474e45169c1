"""A charger's control unit as a process of its own: ``python -m mocks.charger --link PATH [--world DIR]``.

The far end of the CAN wire: a slcan adapter at byte level on a pty (or several, as taps on one bus), or with
``--channel`` any bus of python-can, a real slcan adapter's tty among them. Behind it the charger: states, proximity,
plug lock, contactor, pre-charge and current ramp, temperature, pilot, emergency stop, and its own watch over the
robot's heartbeat. Frames are encoded from the DBC by cantools; no code is shared with the driver. Prints one JSON line
that says where it listens, then serves until SIGTERM; control lines on standard input are described in
``mocks.charger.controls``.

Not simulated: bit timing, arbitration and bus load; error frames and bus-off (a pty has none: the kernel's slcan driver
is the place for them); the tty's baud rate; the vehicle's own protocol (ISO 15118, GB/T 27930, CHAdeMO); insulation
test; the dynamics of real power electronics; power failure of the lock.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import logging
import os
import select
import signal
import sys
import tempfile
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
    """Serve until SIGTERM. Exit status 3: the bus cannot be opened; 2: something else named cannot be used."""
    options = _options(arguments)
    logging.basicConfig(level=logging.INFO if options.verbose else logging.WARNING, format="%(message)s")
    stop = _Stop()
    with contextlib.ExitStack() as stack:
        try:
            frames = Frames(options.dbc, options.protection, options.robot_address, options.charger_address)
            world: Surroundings = Shared(options.world) if options.world else Alone(options.time_scale)
        except Exception as error:  # cantools lets its parser's own exceptions through
            return _complain(2, error)
        try:
            ports = _ports(options, stack)
        except Exception as error:  # so does python-can with its back-ends'
            return _complain(3, error)
        rng = np.random.default_rng(options.seed)
        device = MockCharger(frames, ports, world, rng, lost_s=options.lost_ms / 1000.0)
        where = {"interface": options.interface, "channel": options.channel or str(options.link[0])}
        sys.stdout.write(json.dumps(where) + "\n")
        sys.stdout.flush()
        gc.freeze()  # a collection would hold up the whole device
        _serve(device, ports, stop)
    return 0


def _ports(options: argparse.Namespace, stack: contextlib.ExitStack) -> list[BusPort]:
    """Open every connection to the bus; the stack closes them."""
    ports: list[BusPort] = []
    emulated = options.interface == "slcan" and not options.channel
    if emulated and not options.link:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="portdock-can-"))
        options.link = [Path(folder) / "can"]
    for link in options.link:
        ports.append(SlcanPort(link, options.bitrate))
        stack.callback(ports[-1].close)
    if not emulated:
        ports.append(PythonCanPort(options.interface, options.channel, options.bitrate, options.fd))
        stack.callback(ports[-1].close)
    return ports


def _complain(status: int, error: Exception) -> int:
    sys.stderr.write(f"mock charger: {' '.join(str(error).split()) or type(error).__name__}\n")
    return status


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="mocks.charger", description="A charger's control unit on a mock CAN bus.")
    parser.add_argument(
        "--link", type=Path, action="append", default=[], help="symlink to an emulated slcan adapter; may be repeated"
    )
    parser.add_argument("--interface", default="slcan", help="slcan, or a python-can interface")
    parser.add_argument(
        "--channel", default="", help="a bus that is there: can0, or a slcan adapter's tty; slcan emulates one without"
    )
    parser.add_argument("--bitrate", type=int, default=250_000)
    parser.add_argument("--fd", action="store_true", help="CAN FD, where the interface has it")
    parser.add_argument("--dbc", type=Path, default=None)
    parser.add_argument("--protection", default="e2e-p11", choices=["none", "counter", "j1850", "e2e-p11", "e2e-p5"])
    parser.add_argument("--robot-address", type=int, default=None, help="replaces the DBC's source address")
    parser.add_argument("--charger-address", type=int, default=None, help="replaces the DBC's source address")
    parser.add_argument("--world", type=Path, default=None, help="folder of the mocks' shared blackboard")
    parser.add_argument(
        "--time-scale", type=float, default=1.0, help="emulated seconds for each second, without a world"
    )
    parser.add_argument("--lost-ms", type=float, default=250.0, help="silence after which the robot counts as lost")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args(arguments)
    if options.interface != "slcan" and not options.channel:
        parser.error(f"{options.interface} needs --channel")
    return options


class _Stop:
    """SIGTERM and SIGINT, as a flag and as something to wait on."""

    def __init__(self) -> None:
        self.wanted = False
        self.descriptor, wake = os.pipe()
        os.set_blocking(wake, False)
        signal.signal(signal.SIGTERM, self._come)
        signal.signal(signal.SIGINT, self._come)
        signal.set_wakeup_fd(wake)

    def _come(self, signum: int, frame: FrameType | None) -> None:
        self.wanted = True


def _serve(device: MockCharger, ports: list[BusPort], stop: _Stop) -> None:
    controls = bytearray()
    listening = True
    while not stop.wanted:
        due_s = device.turn(time.monotonic())
        descriptors = [port.descriptor() for port in ports]
        longest_s = _POLL_S if None in descriptors else _LONGEST_WAIT_S
        waiting: list[int] = [stop.descriptor, *(d for d in descriptors if d is not None)]
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
