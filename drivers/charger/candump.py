"""Reading candump's log format ("candump -L"). python-can's own reader takes most error frames for data frames."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from drivers.base import CanFrame
from perception.errors import InputError

_LINE = re.compile(
    r"\((\d+\.\d+)\) +(\S+) +([0-9A-Fa-f]{3,8})#(#[0-9A-Fa-f])?((?:[0-9A-Fa-f]{2})*|[Rr]\d*)(?: +([RrTt]))?"
)
_ERROR_FLAG, _IDENTIFIER = 0x20000000, 0x1FFFFFFF


def read_candump(path: Path) -> Iterator[CanFrame]:
    """The file's frames in their order. Raises InputError for a line that is none, OSError for a file that is none."""
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            if not line.strip():
                continue
            found = _LINE.fullmatch(line.strip())
            if found is None:
                raise InputError(f"{path}, line {number} is not a line of candump's log format")
            time_s, _, identifier, fd, data, way = found.groups()
            value = int(identifier, 16)
            yield CanFrame(
                time_s=float(time_s),
                direction="tx" if way in ("T", "t") else "rx",
                arbitration_id=value & _IDENTIFIER,
                data=b"" if data[:1] in ("R", "r") else bytes.fromhex(data),
                is_extended=len(identifier) > 3 and not value & _ERROR_FLAG,
                is_error=bool(value & _ERROR_FLAG),
                is_fd=fd is not None,
            )
