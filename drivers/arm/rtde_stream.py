"""The arm's state over RTDE protocol version 2, read with a plain socket so that no sample is lost.

ur_rtde's receive interface keeps only the newest of several samples that have queued up, is polled, and holds Python's
global lock while it connects and when it goes; a blocking read in a thread has none of this. The control link, where
the work is in ur_rtde's script, stays with ur_rtde.

Source: "Real-Time Data Exchange (RTDE) Guide", Universal Robots. Big-endian; each package is a 16-bit size that counts
its three header bytes, an 8-bit type, and the payload.
"""

from __future__ import annotations

import contextlib
import socket
import struct
from dataclasses import dataclass

from drivers.arm.errors import ArmAbsentError
from drivers.base import ProtocolError

PORT = 30004
PROTOCOL_VERSION = 2
REQUEST_VERSION, CONTROLLER_VERSION, OUTPUTS, START, DATA = b"VvOSU"

_FORMATS = {"DOUBLE": "d", "VECTOR3D": "3d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "UINT64": "Q"}
VARIABLES = {
    "timestamp": "DOUBLE",
    "actual_q": "VECTOR6D",
    "actual_qd": "VECTOR6D",
    "actual_TCP_pose": "VECTOR6D",
    "actual_TCP_speed": "VECTOR6D",
    "actual_TCP_force": "VECTOR6D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "runtime_state": "UINT32",
    "speed_scaling": "DOUBLE",
    "target_speed_fraction": "DOUBLE",
    "payload": "DOUBLE",
    "payload_cog": "VECTOR3D",
    "actual_digital_output_bits": "UINT64",
}
"""What is asked for, in order, with the type that the controller must confirm."""
_PAYLOAD = struct.Struct(">B" + "".join(_FORMATS[kind] for kind in VARIABLES.values()))

Vector = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class RawSample:
    """One data package, in the controller's own terms and SI units."""

    timestamp_s: float
    q: Vector
    qd: Vector
    tcp_pose: Vector
    tcp_speed: Vector
    tcp_force: Vector
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_scaling: float
    speed_fraction: float
    payload_kg: float
    payload_cog_m: Vector
    digital_outputs: int


def decode(payload: bytes, recipe: int) -> RawSample | None:
    """A data package's payload; None if it belongs to another recipe. Raises ProtocolError for a wrong size."""
    if len(payload) != _PAYLOAD.size:
        raise ProtocolError(f"an RTDE data package of {len(payload)} bytes came instead of {_PAYLOAD.size}")
    v = _PAYLOAD.unpack(payload)
    if v[0] != recipe:
        return None
    motion = v[2:8], v[8:14], v[14:20], v[20:26], v[26:32]
    return RawSample(v[1], *motion, v[32], v[33], v[34], v[35], v[36], v[37], v[38:41], v[41])


class RtdeStream:
    """One connection to the RTDE port."""

    def __init__(self, host: str, timeout_s: float) -> None:
        """Connect and agree on the protocol. Raises ArmAbsentError if no RTDE server answers."""
        self._buffer = bytearray()
        self._recipe = 0
        self._where = f"{host}:{PORT}"
        try:
            self._socket = socket.create_connection((host, PORT), timeout_s)
        except OSError as error:
            raise ArmAbsentError(f"no robot controller answers at {self._where} ({error})") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            if self.ask(REQUEST_VERSION, struct.pack(">H", PROTOCOL_VERSION)) != b"\x01":
                raise ArmAbsentError(f"the controller at {self._where} does not speak RTDE {PROTOCOL_VERSION}")
            numbers = struct.unpack(">4I", self.ask(CONTROLLER_VERSION, b"")[:16])
        except BaseException:
            self.close()
            raise
        self.version: tuple[int, ...] = numbers
        """PolyScope's major, minor, bugfix and build number."""

    def start(self, frequency_hz: float) -> None:
        """Ask for ``VARIABLES`` at a rate, and for data to flow. Raises ArmAbsentError, ProtocolError."""
        answer = self.ask(OUTPUTS, struct.pack(">d", frequency_hz) + ",".join(VARIABLES).encode())
        self._recipe, kinds = answer[0], answer[1:].decode("ascii", "replace").split(",")
        for (name, wanted), kind in zip(VARIABLES.items(), kinds, strict=False):
            if kind != wanted:
                raise ProtocolError(f"the controller offers {name} as {kind}, not {wanted}")
        if len(kinds) != len(VARIABLES) or self.ask(START, b"") != b"\x01":
            raise ProtocolError("the controller does not send the state that was asked for")

    def read(self, timeout_s: float) -> list[RawSample]:
        """All samples that have come in, oldest first; waits for the first. Raises OSError when the link is gone."""
        samples = self._samples()  # some may have come with the answer to the start
        if not samples:
            self._socket.settimeout(timeout_s)
            with contextlib.suppress(TimeoutError):
                self._receive()
            samples = self._samples()
        return samples

    def _samples(self) -> list[RawSample]:
        samples = []
        while (package := self._package()) is not None:
            kind, payload = package
            sample = decode(payload, self._recipe) if kind == DATA else None
            if sample is not None:
                samples.append(sample)
        return samples

    def close(self) -> None:
        """Hang up. Idempotent; wakes a reader in another thread."""
        with contextlib.suppress(OSError):  # it may have been closed by the other side
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def send(self, kind: int, payload: bytes) -> None:
        """Send one package. Raises OSError when the link is gone."""
        self._socket.sendall(struct.pack(">HB", 3 + len(payload), kind) + payload)

    def ask(self, kind: int, payload: bytes) -> bytes:
        """Send one request and return the payload of the answer, which is of the same kind. Raises ArmAbsentError."""
        try:
            self.send(kind, payload)
            while True:
                package = self._package()
                if package is None:
                    self._receive()
                elif package[0] == kind and package[1]:
                    return package[1]
        except (OSError, ProtocolError) as error:
            raise ArmAbsentError(f"no robot controller answers at {self._where} ({error})") from error

    def _receive(self) -> None:
        chunk = self._socket.recv(65536)
        if not chunk:
            raise ConnectionError("closed by the controller")
        self._buffer += chunk

    def _package(self) -> tuple[int, bytes] | None:
        """The next complete package's type and payload, or None."""
        if len(self._buffer) < 3:
            return None
        size, kind = struct.unpack_from(">HB", self._buffer)
        if size < 3:
            raise ProtocolError(f"an RTDE package claims a size of {size} bytes")
        if len(self._buffer) < size:
            return None
        payload = bytes(self._buffer[3:size])
        del self._buffer[:size]
        return kind, payload


def controller_version(host: str, timeout_s: float) -> tuple[int, ...]:
    """PolyScope's (major, minor, bugfix, build). Raises ArmAbsentError if no RTDE server answers."""
    stream = RtdeStream(host, timeout_s)
    stream.close()
    return stream.version
