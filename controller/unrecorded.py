"""Evidence that nobody keeps: for sweeps that only measure something about the site."""

from __future__ import annotations

from drivers.base import NullSink


class Unrecorded(NullSink):
    """``assembly.Evidence`` that drops everything."""

    def command(self, name: str, detail: str, allowed: bool, reason: str) -> None:
        """Drop the decision."""
