"""CAN frames as text in candump's log format, for other tools and for `portdock charger monitor --file`.

Written here and not by python-can, whose writer gives every error frame the same class.
"""

from __future__ import annotations

from collections.abc import Iterable

from drivers.base import CanFrame

_ERROR_FLAG = 0x20000000
_BIT_RATE_SWITCH = 1


def candump_text(frames: Iterable[CanFrame], channel: str = "can0") -> str:
    """One line for each frame; times are those of the frames (the host's monotonic clock)."""
    return "".join(f"({frame.time_s:.6f}) {channel} {_body(frame)}\n" for frame in frames)


def _body(frame: CanFrame) -> str:
    identifier = f"{frame.arbitration_id:08X}" if frame.is_extended else f"{frame.arbitration_id:03X}"
    if frame.is_error:
        identifier = f"{frame.arbitration_id | _ERROR_FLAG:08X}"
    mark = f"##{_BIT_RATE_SWITCH:X}" if frame.is_fd else "#"
    way = "R" if frame.direction == "rx" else "T"
    return f"{identifier}{mark}{frame.data.hex().upper()} {way}"
