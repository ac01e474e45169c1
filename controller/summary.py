"""What a mission came to, as values: what the terminal, the report and ``--json`` say in the end.

Units are those of reports (mm, deg, N): these values are only read by people and scripts, never calculated with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from controller.faults import OutcomeKind as MissionOutcome


@dataclass(frozen=True, slots=True)
class LocateSummary:
    """The locator's last answer; errors are known only where the truth is (dry run, recorded scene)."""

    accepted: bool
    error_mm: float | None
    error_deg: float | None
    elapsed_s: float
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ContactSummary:
    """How the plug sat against the estimate when it stopped: offsets of the actual from the expected pose."""

    along_mm: float
    """Along the mating axis, positive when the plug stopped short."""
    lateral_mm: float
    """Length of the offset across the mating axis."""
    roll_deg: float
    """About the mating axis."""
    tilt_deg: float
    """Between expected and actual mating axis."""
    peak_force_n: float


@dataclass(frozen=True, slots=True)
class MissionSummary:
    """One mission's result."""

    outcome: MissionOutcome
    fault: str | None
    """Stable fault code, None without a fault."""
    remedy: str
    """What an operator does now, in words; empty when there is nothing to do."""
    states: tuple[tuple[str, float], ...]
    """(state, seconds spent in it) in the order they were passed."""
    attempts: int
    locate: LocateSummary | None = None
    contact: ContactSummary | None = None
    recording: Path | None = None
    report: Path | None = None
    warnings: tuple[str, ...] = ()
    """What the drift chart says after this dock."""

    def to_json(self) -> dict[str, object]:
        """The object that ``portdock dry-run --json`` prints; numbers that are not finite become null."""
        told = {"warnings": list(self.warnings)} if self.warnings else {}
        return {
            "outcome": self.outcome,
            "fault": self.fault,
            "states": [[name, _number(seconds)] for name, seconds in self.states],
            "attempts": self.attempts,
            "locate": None if self.locate is None else _locate_json(self.locate),
            "contact": None if self.contact is None else _contact_json(self.contact),
            "recording": None if self.recording is None else str(self.recording),
            "report": None if self.report is None else str(self.report),
            **told,
        }


def _locate_json(locate: LocateSummary) -> dict[str, object]:
    return {
        "accepted": locate.accepted,
        "error_mm": _number(locate.error_mm),
        "error_deg": _number(locate.error_deg),
        "elapsed_s": _number(locate.elapsed_s),
        "reasons": list(locate.reasons),
    }


def _contact_json(contact: ContactSummary) -> dict[str, object]:
    return {
        "along_mm": _number(contact.along_mm),
        "lateral_mm": _number(contact.lateral_mm),
        "roll_deg": _number(contact.roll_deg),
        "tilt_deg": _number(contact.tilt_deg),
        "peak_force_n": _number(contact.peak_force_n),
    }


def _number(value: float | None) -> float | None:
    """Rounded to six decimals (a nanometre, a microsecond): a plain Python float, or None where JSON has no number."""
    return None if value is None or not math.isfinite(value) else round(float(value), 6)
