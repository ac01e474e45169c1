"""What a trace says about an insertion: pure rules on depth, force and time."""

from __future__ import annotations

import enum
from collections.abc import Callable

from controller.insertion_config import InsertionConfig
from controller.insertion_trace import Sample, Trace
from controller.planning import DockPlan


class Verdict(enum.Enum):
    """What the trace says."""

    GOING = "going"
    SEATED = "seated"
    STALLED = "stalled"
    JAMMED = "jammed"
    """Stalled, and wedged: much force across the axis or much moment."""
    OVERLOAD = "overload"
    OVERRUN = "overrun"
    """Deeper than any plug of this port can be."""


ENDS = frozenset({Verdict.SEATED, Verdict.OVERLOAD, Verdict.OVERRUN})
"""After these there is nothing more to try."""


def judge(trace: Trace, plan: DockPlan, settings: InsertionConfig) -> Verdict:
    """What the newest samples mean."""
    if overloaded(trace, settings):
        return Verdict.OVERLOAD
    last, still_s = trace.last, trace.still_for_s()
    if last.depth_m > plan.mated_depth_m + settings.overrun_mm / 1000.0:
        return Verdict.OVERRUN
    home = last.depth_m > plan.mated_depth_m - settings.seated_within_mm / 1000.0
    if home and still_s > settings.plateau_s and last.axial_n > 0.5 * settings.push_force_n:
        return Verdict.SEATED
    if not home and still_s > settings.stall_s:
        return Verdict.JAMMED if wedged(trace, settings) else Verdict.STALLED
    return Verdict.GOING


def overloaded(trace: Trace, settings: InsertionConfig) -> bool:
    """Above a cap for so many samples in a row that it is no noise."""
    return _sustained(trace, settings, lambda s: _over_caps(s, settings))


def wedged(trace: Trace, settings: InsertionConfig) -> bool:
    """Pressed against the port's sides, or twisted in it."""
    return _sustained(
        trace, settings, lambda s: s.lateral_n > settings.jam_lateral_n or s.moment_nm > settings.jam_moment_nm
    )


def explain(verdict: Verdict, trace: Trace, plan: DockPlan, settings: InsertionConfig) -> str:
    """A verdict in numbers, for people."""
    last = trace.last
    where = f"at {last.depth_m * 1000:.1f} of {plan.mated_depth_m * 1000:.1f} mm"
    across = f"{last.lateral_n:.0f} N lateral, {last.moment_nm:.1f} Nm"
    match verdict:
        case Verdict.SEATED:
            return f"home {where}, {last.axial_n:.0f} N"
        case Verdict.OVERLOAD:
            return f"{last.axial_n:.0f} N axial, {across} {where}"
        case Verdict.OVERRUN:
            return f"deeper than home: {where}"
        case Verdict.JAMMED:
            return f"jammed {where} with {last.axial_n:.0f} N axial, {across}"
        case Verdict.STALLED:
            return f"no progress {where} with {last.axial_n:.0f} N"
        case Verdict.GOING:
            return f"time ran out {where} (push {settings.push_force_n:.0f} N)"


def _sustained(trace: Trace, settings: InsertionConfig, holds: Callable[[Sample], bool]) -> bool:
    recent = trace.samples[-settings.overload_samples :]
    return len(recent) == settings.overload_samples and all(holds(s) for s in recent)


def _over_caps(s: Sample, settings: InsertionConfig) -> bool:
    return (
        abs(s.axial_n) > settings.max_axial_force_n
        or s.lateral_n > settings.max_lateral_force_n
        or s.moment_nm > settings.max_moment_nm
    )
