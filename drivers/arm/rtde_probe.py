"""A first, careful look at the RTDE port with a plain socket and short time-outs.

ur_rtde's constructors hold Python's global lock, so that a silent host would freeze every thread of the process: it is
let near a controller only once that has shown to answer and to send data.
"""

from __future__ import annotations

import socket
import struct

from drivers.arm.errors import ArmAbsentError

PORT = 30004
PROTOCOL_VERSION = 2
PROBE_HZ = 125.0


def controller_version(host: str, timeout_s: float) -> tuple[int, int, int, int]:
    """PolyScope's (major, minor, bugfix, build). Raises ArmAbsentError if no RTDE server answers and sends data."""
    try:
        with socket.create_connection((host, PORT), timeout_s) as link:
            link.settimeout(timeout_s)
            if _exchange(link, ord("V"), struct.pack(">H", PROTOCOL_VERSION)) != b"\x01":
                raise ArmAbsentError(f"the controller at {host} does not speak RTDE protocol {PROTOCOL_VERSION}")
            major, minor, bugfix, build = struct.unpack(">4I", _exchange(link, ord("v"), b"")[:16])
            _exchange(link, ord("O"), struct.pack(">d", PROBE_HZ) + b"timestamp")
            _exchange(link, ord("S"), b"")
            _await(link, ord("U"))
            return major, minor, bugfix, build
    except (OSError, struct.error) as error:
        raise ArmAbsentError(f"no robot controller answers at {host}:{PORT} ({error})") from error


def _exchange(link: socket.socket, kind: int, payload: bytes) -> bytes:
    """Send one package and return the payload of the answer, which is of the same kind."""
    link.sendall(struct.pack(">HB", 3 + len(payload), kind) + payload)
    return _await(link, kind)


def _await(link: socket.socket, kind: int) -> bytes:
    """The payload of the next package of a kind."""
    while True:
        size, answer = struct.unpack(">HB", _read(link, 3))
        body = _read(link, size - 3)
        if answer == kind:
            return body


def _read(link: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        chunk = link.recv(count - len(data))
        if not chunk:
            raise ConnectionError("closed by the other side")
        data += chunk
    return data
