"""CAN frames as text in candump's log format, for other tools and for `portdock charger monitor --file`."""

from __future__ import annotations

import io
from collections.abc import Sequence

import can

from drivers.base import CanFrame


def candump_text(frames: Sequence[CanFrame], channel: str = "can0") -> str:
    """One line for each frame; times are those of the frames (the host's monotonic clock)."""
    text = io.StringIO()
    writer = can.CanutilsLogWriter(text, channel=channel)
    for frame in frames:
        writer.on_message_received(
            can.Message(
                timestamp=frame.time_s,
                arbitration_id=frame.arbitration_id,
                is_extended_id=frame.is_extended,
                is_error_frame=frame.is_error,
                is_fd=frame.is_fd,
                is_rx=frame.direction == "rx",
                data=frame.data,
            )
        )
    return text.getvalue()
