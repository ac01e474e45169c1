"""Command line of the emulated controller: arguments, wiring to the mock world, one JSON line when ready."""

from __future__ import annotations

import argparse
import gc
import json
import logging
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mocks.ur.arm import Arm, Environment, Floor, FreeSpace, Sensor
from mocks.ur.control_channel import ControlChannel
from mocks.ur.controller import Controller
from mocks.ur.environment import PortEnvironment
from mocks.ur.kinematics import MODELS, Kinematics, as_built
from mocks.ur.sag import Sag
from mocks.ur.server import UrServer
from mocks.ur.state import Safety
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec

START_JOINTS = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)


def main(arguments: list[str] | None = None) -> int:
    """Run until SIGTERM or SIGINT."""
    options = _parser().parse_args(arguments)
    logging.basicConfig(level=options.log, stream=sys.stderr, format="%(name)s: %(message)s")
    try:
        server = build(options)
    except OSError as error:
        sys.stderr.write(f"mock arm: {error}\n")
        return 3
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: setattr(server, "stopping", True))
    if options.control:
        ControlChannel(server, sys.stdin.fileno(), sys.stdout)
    ports = {name: listener.port for name, listener in server.listeners.items()}
    sys.stdout.write(json.dumps({"host": options.host, "ports": ports}) + "\n")
    sys.stdout.flush()
    gc.freeze()  # a collection would hold up the whole device
    server.run()
    return 0


def build(options: argparse.Namespace) -> UrServer:
    """The server that the options describe. Raises OSError when a port is taken."""
    world = None if options.world is None else WorldSpec.load(options.world)
    board = None if options.world is None else Blackboard.attach(options.world)
    model = options.model or (world.arm_model if world else "ur10e")
    joints = world.start_joints if world else START_JOINTS
    rng = np.random.default_rng(world.seed if world else 0)
    environment: Environment = FreeSpace() if options.floor is None else Floor(options.floor)
    if world is not None and board is not None:
        environment = PortEnvironment(world, board)
    offsets = None if world is None else np.array(world.joint_offsets)
    kinematics, sensor = Kinematics(MODELS[model]), Sensor(rng, 0.3, 0.01, 3.0, 0.1)
    give = 0.0 if world is None else world.joint_compliance_rad_per_nm
    sag = Sag(kinematics, give) if give > 0.0 else None
    lengths = np.zeros(6) if world is None else np.array(world.link_errors_m)
    built = Kinematics(as_built(kinematics.model, lengths)) if lengths.any() else None
    arm = Arm(kinematics, np.array(joints), environment, sensor, offsets, sag, built)
    version = tuple(int(part) for part in options.version.split("."))
    controller = Controller(
        arm, (version[0], version[1], version[2], version[3]), stop_pauses=options.protective_stop == "paused"
    )
    controller.remote = not options.local
    time_scale = board.time_scale if board else options.time_scale
    server = UrServer(controller, options.host, options.rate, _clock(board, time_scale), time_scale, options.programs)
    if board is not None:
        edges = RisingEdges()
        server.after_step = lambda: _publish(controller, board, edges)
    return server


class RisingEdges:
    """Which digital outputs have risen since they were looked at last."""

    def __init__(self) -> None:
        self._before = 0

    def of(self, outputs: int) -> list[int]:
        """Numbers of the outputs that are high now and were low before."""
        risen, self._before = outputs & ~self._before, outputs
        return [number for number in range(8) if risen >> number & 1]


def _publish(controller: Controller, board: Blackboard, edges: RisingEdges) -> None:
    """After each step: flange pose and output edges for the scanner; the cell's E-stop circuit reaches the arm."""
    board.put_arm(controller.time_s, controller.arm.T_base_flange_true)
    for output in edges.of(controller.io.digital_out):
        board.put_edge(controller.time_s, output)
    pressed = board.estop()
    if pressed:
        controller.emergency_stop(system=True)
    elif controller.safety.mode == Safety.SYSTEM_EMERGENCY_STOP:
        controller.release_emergency_stop()


def _clock(board: Blackboard | None, time_scale: float) -> Callable[[], float]:
    if board is not None:
        return board.world_time_s
    start = time.monotonic()
    return lambda: (time.monotonic() - start) * time_scale


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m mocks.ur", description="An emulated UR e-Series controller.")
    parser.add_argument("--host", default="127.0.0.2", help="loopback address of its own")
    parser.add_argument("--world", type=Path, help="run folder with world.json and blackboard; without it, free space")
    parser.add_argument("--model", choices=sorted(MODELS), help="default: the world's, or ur10e")
    parser.add_argument("--version", default="5.15.0.0", help="PolyScope version, four numbers")
    parser.add_argument("--rate", type=int, choices=(125, 500), default=500, help="steps and samples in a second")
    parser.add_argument("--time-scale", type=float, default=1.0, help="emulated seconds per second, without --world")
    parser.add_argument(
        "--control", action="store_true", help="take faults as JSON lines on stdin; its end ends the mock"
    )
    parser.add_argument("--floor", type=float, help="height in m of a floor that the flange can touch, without --world")
    parser.add_argument(
        "--programs", type=Path, help="folder of NAME.script files that the dashboard loads as NAME.urp"
    )
    parser.add_argument(
        "--protective-stop", choices=("paused", "stopped"), default="paused", help="what it leaves the program in"
    )
    parser.add_argument("--local", action="store_true", help="start in local mode: scripts are ignored")
    parser.add_argument("--log", default="WARNING", help="log level")
    return parser
