"""The controller's standard digital outputs over RTDE inputs, on a connection of its own.

The control link's client has no such call, and its recipes leave these variables free; a further RTDE client may write
them. Set up with the first output that is switched. Source: "Real-Time Data Exchange (RTDE) Guide", Universal Robots.
"""

from __future__ import annotations

import struct

from drivers.arm.rtde_stream import DATA, RtdeStream
from drivers.base import LinkLostError, ProtocolError

INPUTS = ord("I")
_VARIABLES = b"standard_digital_output_mask,standard_digital_output"


class OutputLink:
    """Switches outputs 0 to 7 of one controller."""

    def __init__(self, host: str, timeout_s: float = 2.0) -> None:
        self._host = host
        self._timeout_s = timeout_s
        self._stream: RtdeStream | None = None
        self._recipe = 0

    def set(self, number: int, level: bool) -> None:
        """Switch output ``number``. Raises LinkLostError, and ProtocolError where another client holds the outputs."""
        if not 0 <= number <= 7:
            raise ValueError(f"there is no standard digital output {number}")
        stream = self._stream or self._open()
        mask = 1 << number
        try:
            stream.send(DATA, struct.pack(">BBB", self._recipe, mask, mask if level else 0))
        except OSError as error:
            self.close()
            raise LinkLostError(f"output {number} of the controller at {self._host} cannot be switched") from error

    def close(self) -> None:
        """Hang up. Idempotent."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _open(self) -> RtdeStream:
        stream = RtdeStream(self._host, self._timeout_s)
        answer = stream.ask(INPUTS, _VARIABLES)
        if answer[1:] != b"UINT8,UINT8" or stream.ask(ord("S"), b"") != b"\x01":
            stream.close()
            why = answer[1:].decode("ascii", "replace")
            raise ProtocolError(
                f"the controller at {self._host} does not let its outputs be set ({why})",
                remedy="Another RTDE client (a fieldbus, a URCap) may hold the digital outputs: stop it.",
            )
        self._recipe = answer[0]
        self._stream = stream
        return stream
