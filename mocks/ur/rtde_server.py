"""RTDE port 30004: protocol versions 1 and 2 towards any number of clients.

Each message is a big-endian uint16 size (its three header bytes included), a uint8 type and a payload. Wrong-sized
data packages are dropped and logged. Input variables belong to the connection that asked for them first.
"""

from __future__ import annotations

import logging
import math
import struct
from dataclasses import dataclass

from mocks.ur.controller import Controller
from mocks.ur.rtde_variables import InputRecipe, OutputRecipe
from mocks.ur.sockets import Connection

log = logging.getLogger(__name__)

HEADER = struct.Struct(">HB")
VERSION, CONTROLLER_VERSION = ord("V"), ord("v")
SETUP_OUTPUTS, SETUP_INPUTS = ord("O"), ord("I")
START, PAUSE = ord("S"), ord("P")
DATA, MESSAGE = ord("U"), ord("M")


def message(kind: int, payload: bytes) -> bytes:
    """One RTDE message."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


@dataclass(slots=True)
class _Stream:
    recipe: OutputRecipe
    recipe_id: int
    period_s: float
    due_s: float = -math.inf


class Ownership:
    """Which connection writes which input variable; ``reserved`` ones belong to a field bus."""

    def __init__(self) -> None:
        self.owners: dict[str, object] = {}
        self.reserved: set[str] = set()

    def taken_from(self, connection: object) -> frozenset[str]:
        """Variables that this connection cannot have."""
        others = {name for name, owner in self.owners.items() if owner is not connection}
        return frozenset(others | self.reserved)

    def release(self, connection: object) -> None:
        """A connection has closed."""
        self.owners = {name: owner for name, owner in self.owners.items() if owner is not connection}


class RtdeClient:
    """The server's side of one connection."""

    def __init__(self, connection: Connection, controller: Controller, ownership: Ownership, rate_hz: float) -> None:
        self._connection = connection
        self._controller = controller
        self._ownership = ownership
        self._rate_hz = rate_hz
        self._buffer = bytearray()
        self._protocol = 1
        self._streams: list[_Stream] = []
        self._inputs: dict[int, InputRecipe] = {}
        self.started = False

    def received(self, data: bytes) -> None:
        """Bytes from the client, in whatever pieces."""
        self._buffer += data
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size:
                log.warning("RTDE message of impossible size %d: connection closed", size)
                self._connection.close()
                return
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[HEADER.size : size])
            del self._buffer[:size]
            self._handle(kind, payload)

    def closed(self) -> None:
        """The connection has gone."""
        self._ownership.release(self)

    def send_state(self) -> None:
        """Send what is due; a client that does not keep up misses samples."""
        if not self.started or self._connection.backlog:
            return
        now = self._controller.time_s
        for stream in self._streams:
            if now < stream.due_s - 1e-6:
                continue
            on_time = now - stream.due_s < stream.period_s
            stream.due_s = (stream.due_s if on_time else now) + stream.period_s
            self._connection.send(message(DATA, stream.recipe.pack(stream.recipe_id, self._controller)))

    def _handle(self, kind: int, payload: bytes) -> None:
        if kind == DATA:
            self._data(payload)
        elif kind == VERSION and len(payload) == 2:
            accepted = payload in (b"\x00\x01", b"\x00\x02")
            self._protocol = payload[1] if accepted else self._protocol
            self._reply(kind, bytes([accepted]))
        elif kind == CONTROLLER_VERSION:
            self._reply(kind, struct.pack(">4I", *self._controller.version))
        elif kind == SETUP_OUTPUTS:
            self._setup_outputs(payload)
        elif kind == SETUP_INPUTS:
            self._setup_inputs(payload)
        elif kind == START:
            self.started = bool(self._streams) or bool(self._inputs)
            self._reply(kind, bytes([self.started]))
        elif kind == PAUSE:
            self.started = False
            self._reply(kind, b"\x01")
        elif kind != MESSAGE:
            log.warning("RTDE message of unknown type %d dropped", kind)

    def _reply(self, kind: int, payload: bytes) -> None:
        self._connection.send(message(kind, payload))

    def _setup_outputs(self, payload: bytes) -> None:
        frequency = self._rate_hz
        if self._protocol == 2:
            if len(payload) < 8:
                log.warning("RTDE output recipe without frequency dropped")
                return
            frequency = struct.unpack_from(">d", payload)[0]
            payload = payload[8:]
        recipe = OutputRecipe(_names(payload))
        recipe_id = 0
        if recipe.complete and frequency > 0.0:
            recipe_id = len(self._streams) + 1
            period_s = 1.0 / min(frequency, self._rate_hz)
            self._streams.append(_Stream(recipe, recipe_id if self._protocol == 2 else 0, period_s))
        head = bytes([recipe_id]) if self._protocol == 2 else b""
        self._reply(SETUP_OUTPUTS, head + ",".join(recipe.types).encode())

    def _setup_inputs(self, payload: bytes) -> None:
        recipe = InputRecipe(_names(payload), self._ownership.taken_from(self))
        recipe_id = 0
        if recipe.complete:
            recipe_id = len(self._inputs) + 1
            self._inputs[recipe_id] = recipe
            self._ownership.owners |= dict.fromkeys(recipe.names, self)
        self._reply(SETUP_INPUTS, bytes([recipe_id]) + ",".join(recipe.types).encode())

    def _data(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None or len(payload) != 1 + recipe.size:
            log.warning("RTDE data package of %d bytes does not fit its recipe: dropped", len(payload))
            return
        self._controller.write_inputs(recipe.unpack(payload[1:]))


def _names(payload: bytes) -> list[str]:
    """Comma-separated names; ur_rtde ends the list with a comma."""
    return [name.strip() for name in payload.decode("ascii", "replace").split(",") if name.strip()]
