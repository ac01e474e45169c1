"""Profiles and arm samples, each with its own clock -> a ``Scan``: where the flange was when each profile was taken."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from drivers.base import ArmState
from drivers.clock_fit import MAX_DRIFT, fit_clock
from perception.errors import PortdockError
from perception.geometry import Array, Pose, interpolate
from perception.scan import Profile, Scan

logger = logging.getLogger(__name__)

MAX_LOST_SHARE = 0.1
MAX_SPREAD_S = 0.5
MAX_SPREAD_SHARE = 0.5
"""Of the sweep's length: a busy computer is late by less, a clock of another unit or rate is off by more."""
MAX_EARLY_S = 0.02
"""The promptest 5 % of all samples come within this; else perhaps none was prompt, and the cloud would be displaced."""
MAX_EARLY_UNSTEADY_S = 0.002
"""The same where the drift stands at its bound."""
MIN_PROFILES = 10


class SweepError(PortdockError):
    """A sweep is not good enough to be located in: profiles lost, or clocks that do not agree."""

    code: ClassVar[str] = "sweep"
    default_remedy: ClassVar[str] = "Scan again; if it recurs, check the scanner's cable and the load of this computer."


@dataclass(frozen=True, slots=True)
class Timing:
    """How profiles and arm samples, each with its own clock, come to one time."""

    latency_s: float = 0.0
    """Least delay from a profile's device time stamp (the middle of its exposure) to its last byte: half the exposure,
    wire time and what calibration found. In the device's seconds."""
    calibrated_s: float = 0.0
    """The part of it that calibration found: what still counts with a trigger or a shared clock."""
    arm_latency_s: float = 0.0
    """The same for an arm sample."""
    time_scale: float = 1.0
    """Device seconds per host second: not 1 only where mocks run faster than the wall clock."""
    max_lost_share: float = MAX_LOST_SHARE
    shared_clock: bool = False
    """Scanner and arm stamp by one clock: no fit over the host's is needed, delays do not matter."""
    enough_s: float = 0.0
    """Times that are good to this do not matter: at the sweep's speed they cost less than the scanner's own error."""
    clock_period_s: float | None = None
    """With a shared clock: the scanner's stamps start again after so long, the arm's do not."""


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """Profiles and the flange's track in one time."""

    profiles: tuple[Profile, ...]
    times_s: Array
    """(K,) when each profile was measured."""
    track_s: Array
    """(N,) growing."""
    track: tuple[Pose, ...]
    """T_base_flange at ``track_s``."""


def timed(profiles: Sequence[Profile], arm_states: Sequence[ArmState], timing: Timing) -> Timed:
    """Bring both into one time: both clocks are fitted to the host's by the lower envelope of delivery.

    Profiles from before the first or after the last arm sample are left out.

    :raises SweepError: too few or too many lost profiles, no arm samples, or a clock that jumps
    """
    if len(arm_states) < 2:
        raise SweepError(f"{len(arm_states)} arm samples are too few to place profiles by")
    rate = 1.0 / timing.time_scale
    if timing.shared_clock:
        kept_arm, arm_s = _growing(arm_states)
        device_s = _device_times(profiles)
        times_s = _same_period(device_s, profiles, arm_states, timing.clock_period_s) - timing.calibrated_s
    else:
        kept_arm, arm_s = _arm_times(arm_states, timing.arm_latency_s, rate)
        times_s = _profile_times(profiles, timing.latency_s, rate, timing.enough_s)
    inside = (times_s >= arm_s[0]) & (times_s <= arm_s[-1])
    kept = [profile for profile, known in zip(profiles, inside, strict=True) if known]
    _refuse_gaps(kept, len(profiles), timing.max_lost_share)
    return Timed(tuple(kept), times_s[inside], arm_s, tuple(state.T_base_flange for state in kept_arm))


def scan_of(sweep: Timed, T_flange_scanner: Pose) -> Scan:
    """The scan: the flange's pose interpolated at each profile's time."""
    poses = interpolate(sweep.track_s, sweep.track, sweep.times_s)
    return Scan(sweep.profiles, tuple(poses), T_flange_scanner)


def join(
    profiles: Sequence[Profile], arm_states: Sequence[ArmState], T_flange_scanner: Pose, timing: Timing | None = None
) -> Scan:
    """The scan that profiles and arm samples make together: ``timed``, then ``scan_of``. Raises SweepError."""
    return scan_of(timed(profiles, arm_states, timing or Timing()), T_flange_scanner)


def clock_facts(
    profiles: Sequence[Profile], states: Sequence[ArmState], time_scale: float
) -> tuple[tuple[str, str], ...]:
    """Offset, drift and spread of both clocks on the host's, as texts for a recording."""
    samples = {
        "arm": [(state.device_time_s, state.time_s) for state in _growing(states)[0]] if states else [],
        "scanner": [(p.device_time_s, p.time_s) for p in profiles if p.device_time_s is not None],
    }
    facts = []
    for name, pairs in samples.items():
        if pairs:
            device_s, host_s = np.array(pairs).T
            fit = fit_clock(device_s, host_s, rate=1.0 / time_scale)
            facts += [
                (f"{name}_offset_s", f"{fit.offset_s:.6f}"),
                (f"{name}_drift_ppm", f"{fit.drift * 1e6:.2f}"),
                (f"{name}_spread_ms", f"{fit.spread_s * 1e3:.3f}"),
            ]
    return tuple(facts)


def lost_profiles(profiles: Sequence[Profile]) -> int:
    """Profiles that are missing between the first and the last, by their sequence numbers."""
    if not profiles:
        return 0
    return profiles[-1].sequence - profiles[0].sequence + 1 - len(profiles)


def _profile_times(profiles: Sequence[Profile], latency_s: float, rate: float, enough_s: float) -> Array:
    """Host times (N,) of exposure."""
    host_s = np.array([profile.time_s for profile in profiles])
    device_s = [profile.device_time_s for profile in profiles if profile.device_time_s is not None]
    if not profiles or len(device_s) < len(profiles):
        return host_s - latency_s * rate
    return _on_host(np.array(device_s), host_s, rate, "scanner", enough_s) - latency_s * rate


def _device_times(profiles: Sequence[Profile]) -> Array:
    """The scanner's own times (N,) of exposure. Raises SweepError where it sends none."""
    device_s = [profile.device_time_s for profile in profiles if profile.device_time_s is not None]
    if len(device_s) < len(profiles):
        raise SweepError("the scanner sends no time stamps", remedy="Set scanner.sync: timestamp in the site file.")
    return np.array(device_s)


def _same_period(
    device_s: Array, profiles: Sequence[Profile], states: Sequence[ArmState], period_s: float | None
) -> Array:
    """The scanner's times (N,) in the arm's count: whole periods further on, as the times of arrival tell."""
    if period_s is None or not len(device_s):
        return device_s
    at_arrival_s = np.interp(
        [profile.time_s for profile in profiles],
        [state.time_s for state in states],
        [state.device_time_s for state in states],
    )
    periods = np.round(float(np.median(at_arrival_s - device_s)) / period_s)
    return np.asarray(device_s + periods * period_s)


def _growing(states: Sequence[ArmState]) -> tuple[list[ArmState], Array]:
    """Samples with growing device time, and those times (N,)."""
    device_s = np.array([state.device_time_s for state in states])
    newer = np.concatenate([[True], device_s[1:] > np.maximum.accumulate(device_s)[:-1]])
    return [state for state, new in zip(states, newer, strict=True) if new], device_s[newer]


def _arm_times(states: Sequence[ArmState], latency_s: float, rate: float) -> tuple[list[ArmState], Array]:
    """Samples with growing device time, and their host times (N,)."""
    kept, device_s = _growing(states)
    host_s = np.array([state.time_s for state in kept])
    return kept, _on_host(device_s, host_s, rate, "arm") - latency_s * rate


def _on_host(device_s: Array, host_s: Array, rate: float, name: str, enough_s: float = 0.0) -> Array:
    fit = fit_clock(device_s, host_s, rate=rate)
    delays_ms = fit.early_s * 1e3, fit.spread_s * 1e3
    logger.info("%s clock: drift %.1f ppm, delivery 5 %% within %.1f, 95 %% %.1f ms", name, fit.drift * 1e6, *delays_ms)
    if fit.spread_s > max(MAX_SPREAD_S, MAX_SPREAD_SHARE * float(np.ptp(host_s))):
        raise SweepError(
            f"the {name}'s clock does not run with this computer's: samples came up to {fit.spread_s:.2f} s late",
            remedy="Check the load of this computer and the unit of the device's time stamp; scan again.",
        )
    unsteady = abs(fit.drift) > 0.999 * MAX_DRIFT  # delays that grow or shrink over the sweep pull at the slope
    if fit.early_s > max(enough_s, MAX_EARLY_UNSTEADY_S if unsteady else MAX_EARLY_S):
        raise SweepError(
            f"it is uncertain when samples of the {name} were taken: even the promptest 5 % came spread over"
            f" {fit.early_s * 1e3:.0f} ms",
            remedy="This computer is too busy to sweep: stop other programs, or run mocks at their own pace.",
        )
    return fit.host_s(device_s)


def _refuse_gaps(kept: Sequence[Profile], received: int, max_lost_share: float) -> None:
    if len(kept) < MIN_PROFILES:
        raise SweepError(f"the sweep has {len(kept)} usable profiles of {received} received")
    lost = lost_profiles(kept)
    share = lost / (lost + len(kept))
    if share > max_lost_share:
        raise SweepError(
            f"{lost} of {lost + len(kept)} profiles were lost ({share:.0%}, at most {max_lost_share:.0%} allowed)"
        )
