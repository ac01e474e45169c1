"""The state of one link."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """State of one link, judged by what was received, never by a thread being alive."""

    up: bool
    last_rx_s: float | None
    """Host's monotonic time of the last good data; None before the first."""
    counters: tuple[tuple[str, int], ...] = ()
    """(name, count): bytes, frames, bytes_dropped, bad_checksum, late, lost, overruns, ..."""
    detail: str = ""
