"""Frames of the mock charger: encoded from the DBC through cantools, counters and checksums of its own."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools

from mocks.charger.checksum import fits, protect

MODULUS = {"e2e-p5": 256}


@dataclass(frozen=True, slots=True)
class BusFrame:
    """A frame on the mock bus."""

    identifier: int
    data: bytes
    extended: bool = True
    remote: bool = False
    fd: bool = False


class Frames:
    """The contract as the charger holds it: names to frames and back."""

    def __init__(
        self, dbc: Path | None, scheme: str, robot_address: int | None = None, charger_address: int | None = None
    ) -> None:
        """The addresses replace the lowest byte of the identifiers; None keeps the DBC's."""
        bundled = "portdock_fd.dbc" if scheme == "e2e-p5" else "portdock.dbc"
        path = dbc or Path(str(importlib.resources.files("config") / "dbc" / bundled))
        self._path, self._scheme = path, scheme
        database: Any = cantools.database.load_file(path)
        self._database = database
        self._counters: dict[str, int] = {}
        self._addresses = robot_address, charger_address
        self._messages = {self._identifier(message): message for message in database.messages}

    def _identifier(self, message: Any) -> int:
        address = self._addresses[message.name.startswith("CH_")]
        return int(message.frame_id if address is None else message.frame_id & ~0xFF | address)

    def twin(self) -> Frames:
        """The same messages with counters of their own."""
        return Frames(self._path, self._scheme, *self._addresses)

    @property
    def modulus(self) -> int:
        """Values that a counter runs through."""
        return MODULUS.get(self._scheme, 15)

    @property
    def counted(self) -> bool:
        """Whether counters mean anything."""
        return self._scheme != "none"

    def cycle_s(self, name: str) -> float:
        """The message's period."""
        return float(self._database.get_message_by_name(name).cycle_time) / 1000.0

    def encode(self, name: str, values: dict[str, Any], *, stuck: bool = False, damaged: bool = False) -> BusFrame:
        """The message's next frame; ``stuck`` keeps its counter where it was, ``damaged`` spoils its checksum."""
        message = self._database.get_message_by_name(name)
        counter = self._counters.get(name, -1)
        counter = counter if stuck and counter >= 0 else (counter + 1) % self.modulus
        self._counters[name] = counter
        header = {s.name: 0 for s in message.signals if s.name in ("CRC8", "CRC16")} | {"Counter": counter}
        data = bytearray(message.encode(values | header))
        protect(data, self._scheme, self._data_id(message), self._checksum_at(message))
        if damaged:
            data[0] ^= 0x5A
        return BusFrame(self._identifier(message), bytes(data), message.is_extended_frame, fd=message.is_fd)

    def decode(self, frame: BusFrame) -> tuple[str, dict[str, Any]] | None:
        """Name and values of a robot's frame; None for a foreign, damaged or ill-fitting one."""
        message = self._messages.get(frame.identifier)
        if message is None or frame.extended != message.is_extended_frame:
            return None
        if frame.remote or len(frame.data) != message.length or message.name.startswith("CH_"):
            return None
        if not fits(frame.data, self._scheme, self._data_id(message), self._checksum_at(message)):
            return None
        values: dict[str, Any] = message.decode(frame.data, decode_choices=False)
        return str(message.name), values

    @staticmethod
    def _data_id(message: Any) -> int:
        return int(message.dbc.attributes["E2EDataID"].value)

    @staticmethod
    def _checksum_at(message: Any) -> int:
        return next((int(s.start) // 8 for s in message.signals if s.name in ("CRC8", "CRC16")), 0)
