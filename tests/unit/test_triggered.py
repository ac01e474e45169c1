"""Profile k belongs to trigger edge k; where that cannot be, the sweep is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from controller.sweep import SweepError, Timing
from controller.triggered import timed_by_trigger
from tests.benchmarks.test_sync_error import USUAL, arm_states, profiles


def triggered() -> tuple[list, list]:  # type: ignore[type-arg]
    rng = np.random.default_rng(1)
    states = arm_states(rng)
    rising = [b for a, b in pairwise(states) if b.digital_outputs > a.digital_outputs]
    return profiles(rng, np.array([state.device_time_s - 9000.0 for state in rising])), states


def test_each_profile_stands_at_its_edge() -> None:
    found, states = triggered()
    sweep = timed_by_trigger(found, states, 0, USUAL)
    assert 0.038 < np.diff(sweep.times_s).min() < np.diff(sweep.times_s).max() < 0.062
    assert len(sweep.profiles) == len(found)
    device_s = np.array([profile.device_time_s for profile in sweep.profiles])
    np.testing.assert_allclose(sweep.times_s - 9000.0, device_s - 100.0, atol=1e-3)


def test_the_calibrated_delay_moves_all_of_them() -> None:
    found, states = triggered()
    plain = timed_by_trigger(found, states, 0, USUAL)
    moved = timed_by_trigger(found, states, 0, replace(USUAL, calibrated_s=0.003))
    np.testing.assert_allclose(plain.times_s[1:-1] - moved.times_s[1:-1], 0.003)


def test_too_many_edges_without_a_profile_are_refused_with_the_count() -> None:
    found, states = triggered()
    few = [profile for profile in found if profile.sequence % 5]
    with pytest.raises(SweepError, match=r"\d\d of 1\d\d trigger edges gave no profile"):
        timed_by_trigger(few, states, 0, USUAL)


def test_a_scanner_that_runs_free_is_found_out() -> None:
    found, states = triggered()
    free = [replace(p, device_time_s=100.0 + 0.031 * p.sequence, time_s=500.5 + 0.031 * p.sequence) for p in found]
    with pytest.raises(SweepError, match=r"do not belong together|gave no profile"):
        timed_by_trigger(free, states, 0, USUAL)


def test_another_output_is_not_taken_for_the_trigger() -> None:
    found, states = triggered()
    with pytest.raises(SweepError, match="0 trigger edges"):
        timed_by_trigger(found, states, 3, Timing())
