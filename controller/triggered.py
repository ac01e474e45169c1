"""Profiles that an edge of the arm's digital output started: profile k belongs to edge k, so its pose needs no clock.

The scanner exposes once for each rising edge; the arm's samples say in which control cycle the output rose. Which edge
a profile's number stands for is found once for the whole sweep, from the intervals: edges are given unevenly on
purpose. A scanner that skips a trigger or counts one twice is refused, not guessed at.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from controller.sweep import MIN_PROFILES, SweepError, Timed, Timing
from drivers.base import ArmState
from perception.geometry import Array
from perception.scan import Profile

Ints = NDArray[np.int64]

FITS_S = 0.004
"""Two control cycles of an e-Series arm: more than that apart, an edge and an exposure are not the same."""


def unevenness(number: int) -> float:
    """By how much of itself the interval after edge ``number`` is longer, 0 to a half; does not repeat for 1,009."""
    return 0.5 * (number**3 % 1009) / 1009.0


def timed_by_trigger(profiles: Sequence[Profile], arm_states: Sequence[ArmState], output: int, timing: Timing) -> Timed:
    """Profiles at the times of their edges, in the arm's own time. Raises SweepError.

    ``timing.calibrated_s`` is the constant delay that calibration found.
    """
    kept_arm, arm_s, edges = _edges(arm_states, output)
    if len(edges) < MIN_PROFILES or len(profiles) < MIN_PROFILES:
        raise SweepError(
            f"{len(edges)} trigger edges and {len(profiles)} profiles are too few",
            remedy="Check the wire from the arm's output to the scanner's trigger input, and scanner.trigger_output.",
        )
    number = np.array([profile.sequence - profiles[0].sequence for profile in profiles])
    edge_of = number + _first_edge(profiles, number, arm_s[edges])
    known = (edge_of >= 0) & (edge_of < len(edges))
    _refuse_missing(int(known.sum()), len(edges), timing.max_lost_share)
    kept = [profile for profile, inside in zip(profiles, known, strict=True) if inside]
    edge_s = arm_s[edges[edge_of[known]]]
    times_s = np.clip(edge_s - timing.calibrated_s, arm_s[0], arm_s[-1])
    return Timed(tuple(kept), times_s, arm_s, tuple(state.T_base_flange for state in kept_arm))


def _edges(states: Sequence[ArmState], output: int) -> tuple[list[ArmState], Array, Ints]:
    """Samples with growing device time, those times (N,), and which of them show the output just risen."""
    kept: list[ArmState] = []
    for state in states:
        if not kept or state.device_time_s > kept[-1].device_time_s:
            kept.append(state)
    high = np.array([state.digital_outputs >> output & 1 for state in kept], np.int64)
    return kept, np.array([state.device_time_s for state in kept]), np.flatnonzero(np.diff(high) == 1) + 1


def _first_edge(profiles: Sequence[Profile], number: Ints, edge_s: Array) -> int:
    """Number of the first profile's edge: that at which both clocks see the same intervals.

    Edges come at uneven intervals (``sweeping.Pulser``), so one place only fits. Raises SweepError where none does.
    """
    device_s = np.array([p.time_s if p.device_time_s is None else p.device_time_s for p in profiles])
    scores = []
    for shift in range(-int(number[-1]), len(edge_s)):
        at = number + shift
        inside = (at >= 0) & (at < len(edge_s))
        if 2 * int(inside.sum()) >= len(at):
            apart_s = device_s[inside] - edge_s[at[inside]]
            scores.append((float(np.median(np.abs(apart_s - np.median(apart_s)))), shift))
    scores.sort()
    if not scores or scores[0][0] > FITS_S or (len(scores) > 1 and scores[1][0] < 2.0 * scores[0][0] + FITS_S / 4):
        raise SweepError(
            "profiles and trigger edges do not belong together",
            remedy="Check that the scanner is in trigger mode, that nothing else triggers it, and scanner.trigger_hz.",
        )
    return scores[0][1]


def _refuse_missing(found: int, edges: int, max_lost_share: float) -> None:
    lost = edges - found
    if found < MIN_PROFILES or lost > max_lost_share * edges:
        raise SweepError(f"{lost} of {edges} trigger edges gave no profile (at most {max_lost_share:.0%} allowed)")
