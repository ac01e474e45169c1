"""One target swept both ways tells the constant offset between the scanner's clock and the arm's."""

from __future__ import annotations

import numpy as np
import pytest

from perception.geometry import Pose
from perception.scan import Profile
from perception.time_offset import TimedSweep, TimeOffsetError, estimate_time_offset

SPEED_M_S = 0.03
HAND_EYE = Pose.from_vector([0.0, -0.09, 0.04, 0.0, 0.0, 0.0])
DOWN = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.4, 0.0, 0.5]))


def relief(x: np.ndarray, y: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Height of the target: waves across the motion, 6 mm high."""
    return 0.003 * np.sin(2 * np.pi * y / 0.04) + 0.002 * np.cos(2 * np.pi * x / 0.05)


def sweep(direction: int, late_s: float, noise_m: float = 3e-5, flat: bool = False) -> TimedSweep:
    """Profiles of the target; their times are told ``late_s`` too late."""
    rng = np.random.default_rng(direction + 5)
    track_s = np.arange(0.0, 4.0, 0.008)

    def flange(time_s: float) -> Pose:
        return DOWN.moved([0.0, -direction * SPEED_M_S * (time_s - 2.0), 0.0])

    times_s = np.arange(0.5, 3.5, 1 / 50)
    x = np.linspace(-0.05, 0.05, 200)
    profiles = []
    for number, time_s in enumerate(times_s):
        laser = flange(time_s) @ HAND_EYE
        y = np.full_like(x, laser.translation[1])
        height = np.zeros_like(x) if flat else relief(laser.translation[0] + x, y)
        depth = laser.translation[2] - height + noise_m * rng.standard_normal(len(x))
        profiles.append(Profile(number, time_s, None, np.column_stack([x, depth])))
    return TimedSweep(profiles, times_s + late_s, track_s, [flange(t) for t in track_s], HAND_EYE)


@pytest.mark.parametrize("late_s", [0.0, 0.004, -0.0125, 0.06])
def test_the_offset_is_found_to_a_tenth_of_a_millisecond(late_s: float) -> None:
    found = estimate_time_offset(sweep(1, late_s), sweep(-1, late_s))
    assert found.offset_s == pytest.approx(-late_s, abs=1e-4)
    assert found.sigma_s < 1e-4
    assert found.residual_m < 2e-4


def test_a_target_without_edges_across_the_motion_is_refused() -> None:
    with pytest.raises(TimeOffsetError, match="lean against the motion"):
        estimate_time_offset(sweep(1, 0.01, 0.0, flat=True), sweep(-1, 0.01, 0.0, flat=True))


def test_sweeps_without_the_arms_track_are_refused() -> None:
    whole = sweep(1, 0.0)
    elsewhere = TimedSweep(whole.profiles, whole.times_s + 100.0, whole.track_s, whole.track, HAND_EYE)
    with pytest.raises(TimeOffsetError, match="track"):
        estimate_time_offset(elsewhere, sweep(-1, 0.0))
