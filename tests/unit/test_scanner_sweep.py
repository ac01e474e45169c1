"""Profiles and arm samples with clocks of their own become one scan in one time."""

from __future__ import annotations

import numpy as np
import pytest

from controller.sweep import SweepError, Timing, join, lost_profiles
from drivers.base import ArmState, RobotMode, SafetyMode
from perception.geometry import Pose
from perception.scan import Profile

SPEED_M_S = 0.02
HAND_EYE = Pose.from_vector([0.01, 0.02, 0.1, 0.1, -0.2, 0.3])


def flange_at(time_s: float) -> Pose:
    return Pose.from_vector([0.4, 0.1 + SPEED_M_S * time_s, 0.5, 0.1 * time_s, 1.0, 0.2])


def arm_state(time_s: float, host_s: float, device_s: float) -> ArmState:
    T_flange_tcp = Pose.from_vector([0, 0, 0.2, 0, 0, 0])
    return ArmState(
        host_s, device_s, flange_at(time_s) @ T_flange_tcp, T_flange_tcp, np.zeros(6), np.zeros(6), np.zeros(6),
        RobotMode.RUNNING, SafetyMode.NORMAL, True, True, 1.0,
    )  # fmt: skip


def sweep(
    seed: int = 0, jitter_s: float = 0.0, ppm: float = 0.0, scale: float = 1.0, late_s: float = 0.0
) -> tuple[list[Profile], list[ArmState]]:
    """8 s: the host's clock starts at 500 and runs 1/scale as fast, the scanner's at 100, the arm's at 9000."""
    rng = np.random.default_rng(seed)
    arm_t, profile_t = np.arange(0, 8, 0.002), np.arange(0.5, 7.5, 1 / 70)
    states = [arm_state(t, 500 + t / scale + rng.uniform(0, jitter_s), 9000 + t) for t in arm_t]
    points = np.array([[0.0, 0.3], [0.01, 0.31]])
    profiles = [
        Profile(k, 500 + (t + late_s) / scale + rng.uniform(0, jitter_s), 100 + t * (1 + ppm * 1e-6), points)
        for k, t in enumerate(profile_t)
    ]
    return profiles, states


def worst_error_m(profiles: list[Profile], states: list[ArmState], **options: float) -> float:
    scan = join(profiles, states, HAND_EYE, Timing(**options))  # type: ignore[arg-type]
    true = [flange_at(0.5 + profile.sequence / 70) for profile in scan.profiles]
    return max(a.distance_to(b) for a, b in zip(scan.T_base_flange, true, strict=True))


def test_each_profile_gets_the_flanges_pose_at_its_own_time() -> None:
    assert worst_error_m(*sweep()) < 1e-7


def test_five_milliseconds_of_jitter_and_50_ppm_cost_less_than_a_twentieth_of_a_millimetre() -> None:
    assert max(worst_error_m(*sweep(seed, 0.005, 50.0)) for seed in range(3)) < 0.05e-3


def test_without_the_clock_fit_the_same_jitter_would_show() -> None:
    profiles, states = sweep(0, 0.005, 50.0)
    bare = [Profile(p.sequence, p.time_s, None, p.points) for p in profiles]
    assert worst_error_m(bare, states) > 0.09e-3


def test_a_known_constant_delay_is_taken_out() -> None:
    profiles, states = sweep(late_s=0.03)
    assert worst_error_m(profiles, states) == pytest.approx(0.03 * SPEED_M_S, rel=1e-3)
    assert worst_error_m(profiles, states, latency_s=0.03) < 1e-7


def test_a_world_that_runs_faster_than_the_wall_clock_joins_as_well() -> None:
    assert worst_error_m(*sweep(scale=5.0), time_scale=5.0) < 1e-7


def test_a_clock_of_another_rate_is_refused_not_fitted() -> None:
    with pytest.raises(SweepError, match="clock"):
        join(*sweep(scale=5.0), HAND_EYE)


def test_a_sweep_without_any_prompt_profile_is_refused_for_its_place_is_uncertain() -> None:
    profiles, states = sweep()
    late = [Profile(p.sequence, p.time_s + 0.5 + 0.004 * p.sequence, p.device_time_s, p.points) for p in profiles]
    with pytest.raises(SweepError, match="uncertain when"):
        join(late, states, HAND_EYE)
    assert len(join(late, states, HAND_EYE, Timing(enough_s=0.25)).profiles) > 100, "good enough for a coarse scanner"
    delayed = [
        Profile(p.sequence, p.time_s + 0.004 * max(0, p.sequence - 50), p.device_time_s, p.points) for p in profiles
    ]
    assert worst_error_m(delayed, states) < 5e-5  # what the bound on drift lets through


def test_profiles_outside_the_known_arm_times_are_left_out() -> None:
    profiles, states = sweep()
    scan = join(profiles, states[500:3000], HAND_EYE)
    assert 0.5 + scan.profiles[0].sequence / 70 >= 1.0
    assert 0.5 + scan.profiles[-1].sequence / 70 <= 6.0


def test_lost_profiles_are_counted_and_too_many_refused() -> None:
    profiles, states = sweep()
    thinned = [profile for profile in profiles if profile.sequence % 20 != 3]
    assert lost_profiles(thinned) == sum(1 for p in profiles[:-1] if p.sequence % 20 == 3)
    assert len(join(thinned, states, HAND_EYE).profiles) == len(thinned)
    with pytest.raises(SweepError, match=r"2\d\d of 4\d\d profiles were lost \(50%"):
        join(profiles[::2], states, HAND_EYE)


def test_a_sweep_without_profiles_or_arm_samples_is_refused() -> None:
    profiles, states = sweep()
    with pytest.raises(SweepError, match="arm samples"):
        join(profiles, states[:1], HAND_EYE)
    with pytest.raises(SweepError, match="0 usable profiles"):
        join([], states, HAND_EYE)


def test_the_cloud_lies_where_the_laser_saw_it() -> None:
    profiles, states = sweep()
    cloud = join(profiles, states, HAND_EYE).to_cloud()
    expected = (flange_at(0.5) @ HAND_EYE).apply(np.array([[0.0, 0.0, 0.3]]))
    np.testing.assert_allclose(cloud.points[:1], expected, atol=1e-7)
