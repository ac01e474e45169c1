"""Primary and secondary port (30001, 30002): ten state messages a second, robot messages, scripts in.

Layout after Universal Robots' client interface for PolyScope 5: every message is a big-endian int32 size (itself
included) and a uint8 type; a state message (16) holds sub-packages with the same head. Sent are robot mode, joints,
tool, masterboard, Cartesian and kinematics data, the version message on connection and key messages when programs
start and stop. Not sent: configuration, force-mode and calibration data, text and error messages.
"""

from __future__ import annotations

import math
import struct

from mocks.spatial import pose_of
from mocks.ur.controller import Controller
from mocks.ur.script_server import ScriptClient
from mocks.ur.sockets import Connection
from mocks.ur.state import PowerMode, RuntimeState, Safety

PERIOD_S = 0.1
ROBOT_STATE, ROBOT_MESSAGE = 16, 20
VERSION, KEY = 3, 7
_SOURCE = 254  # the controller
_JOINT_RUNNING, _JOINT_IDLE = 253, 255


class PrimaryClient(ScriptClient):
    """The server's side of one connection."""

    def __init__(self, connection: Connection, controller: Controller) -> None:
        super().__init__(connection, controller)
        self._connection = connection
        self._due_s = -math.inf
        connection.send(version_message(controller))

    def send_state(self) -> None:
        """Send what is due; a client that does not keep up misses messages."""
        now = self.controller.time_s
        if now < self._due_s - 1e-6 or self._connection.backlog:
            return
        self._due_s = now + PERIOD_S
        self._connection.send(state_message(self.controller))

    def send_key(self, title: str, text: str) -> None:
        """Tell that a program has started or stopped."""
        body = struct.pack(">iiB", 0, 0, len(title)) + title.encode() + text.encode()
        self._connection.send(_robot_message(self.controller, KEY, body))


def version_message(controller: Controller) -> bytes:
    """The first message on every connection."""
    major, minor, bugfix, build = controller.version
    name = b"URControl"
    body = bytes([len(name)]) + name + struct.pack(">BBii", major, minor, bugfix, build) + b"01-01-2024, 00:00:00"
    return _robot_message(controller, VERSION, body)


def state_message(controller: Controller) -> bytes:
    """One robot state message."""
    packages = (
        _package(0, _robot_mode(controller)),
        _package(1, _joints(controller)),
        _package(2, struct.pack(">BBddfBffB", 0, 0, 0.0, 0.0, 0.0, 0, 0.0, 29.0, _JOINT_RUNNING)),
        _package(3, _masterboard(controller)),
        _package(4, struct.pack(">12d", *controller.tcp_pose, *pose_of(controller.arm.reference.T_flange_tcp))),
        _package(5, _kinematics(controller)),
    )
    return _package(ROBOT_STATE, b"".join(packages))


def _package(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


def _robot_message(controller: Controller, kind: int, body: bytes) -> bytes:
    return _package(ROBOT_MESSAGE, struct.pack(">QBB", _microseconds(controller), _SOURCE, kind) + body)


def _microseconds(controller: Controller) -> int:
    return max(0, round(controller.time_s * 1e6))


def _robot_mode(controller: Controller) -> bytes:
    safety = controller.safety.mode
    return struct.pack(
        ">Q7BBBdddB",
        _microseconds(controller),
        True,
        True,
        controller.power.powered,
        safety in (Safety.ROBOT_EMERGENCY_STOP, Safety.SYSTEM_EMERGENCY_STOP),
        safety == Safety.PROTECTIVE_STOP,
        controller.runtime_state == RuntimeState.PLAYING,
        controller.runtime_state == RuntimeState.PAUSED,
        controller.power.mode,
        0,
        controller.arm.slider,
        controller.arm.scaling,
        1.0,
        0,
    )


def _joints(controller: Controller) -> bytes:
    mode = _JOINT_RUNNING if controller.power.mode == PowerMode.RUNNING else _JOINT_IDLE
    arm = controller.arm
    return b"".join(
        struct.pack(">dddffffB", q, q, qd, 0.5, 48.0, 28.0, 0.0, mode) for q, qd in zip(arm.q, arm.qd, strict=True)
    )


def _masterboard(controller: Controller) -> bytes:
    io = controller.io
    analog = struct.pack(">BBddBBdd", 0, 0, 0.0, 0.0, io.analog_types >> 2 & 1, io.analog_types >> 3 & 1, *io.analog)
    supply = struct.pack(">ffff", 30.0, 48.0, 0.6, 0.02)
    modes = struct.pack(">BBBIBBB", controller.safety.mode, 0, 0, 0, 0, 0, 0)
    return struct.pack(">II", io.digital_in, io.digital_out) + analog + supply + modes


def _kinematics(controller: Controller) -> bytes:
    m = controller.arm.reference.kinematics.model
    half = math.pi / 2
    rows = (
        (0.0,) * 6,
        (0.0, m.a2, m.a3, 0.0, 0.0, 0.0),
        (m.d1, 0.0, 0.0, m.d4, m.d5, m.d6),
        (half, 0.0, 0.0, half, -half, 0.0),
    )
    return struct.pack(">6I", *[0] * 6) + b"".join(struct.pack(">6d", *row) for row in rows) + struct.pack(">I", 1)
