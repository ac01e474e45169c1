"""What each way of knowing when a profile was taken costs in the cloud: emulated, so the same on every machine.

The mock's own bytes and its model of latency, jitter, clock offset and drift; the driver's parser; the controller's
join. An arm at 20 mm/s, 5 ms of jitter, 50 ppm of drift. The error of a point is its distance from where it lies when
it is placed by the arm's true pose at the true time of exposure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from controller.scanner_files import load_scanner
from controller.sweep import Timing, join, scan_of
from controller.triggered import timed_by_trigger, unevenness
from drivers.base import ArmState, RobotMode, SafetyMode
from drivers.scanner.frame_parser import FrameParser
from mocks.scanner import wide_xz
from mocks.scanner.streaming_device import StreamTiming
from perception.geometry import Pose
from perception.scan import Profile, Scan

SPEED_M_S = 0.020
BAUD = 3_000_000
EXPOSURE_S, LATENCY_S = 500e-6, 2e-3
DEVICE = StreamTiming(70.0, EXPOSURE_S, LATENCY_S, jitter_s=0.005, clock_offset_s=100.0, clock_drift_ppm=50.0)
LEAST_DELAY_S = EXPOSURE_S / 2 + LATENCY_S + 4020 * 10 / BAUD
HAND_EYE = Pose.from_vector([0.0, -0.09, 0.04, 0.0, 0.0, 0.0])
LENGTH_S = 8.0
ARM_HZ = 500.0
Record = Callable[[str, object], None]


def flange(time_s: float) -> Pose:
    return Pose.from_vector([0.4, SPEED_M_S * time_s, 0.5, 0.0, 0.0, 0.0])


def arm_states(rng: np.random.Generator, at: Callable[[float], Pose] = flange) -> list[ArmState]:
    """500 Hz, its clock 9,000 s ahead, delivered up to 2 ms late; output 0 rises every 40 to 60 ms."""
    states = []
    rises_s = 0.5 + np.cumsum([0.04 * (1.0 + unevenness(k)) for k in range(140)])
    for time_s in np.arange(0.0, LENGTH_S, 1 / ARM_HZ):
        high = bool(np.any((rises_s <= time_s) & (time_s < rises_s + 0.02)))
        states.append(
            ArmState(
                500.0 + time_s + rng.uniform(0.0, 0.002), 9000.0 + time_s, at(time_s), Pose.identity(), np.zeros(6),
                np.zeros(6), np.zeros(6), RobotMode.RUNNING, SafetyMode.NORMAL, True, True, 1.0, int(high),
            )
        )  # fmt: skip
    return states


def profiles(rng: np.random.Generator, times_s: np.ndarray) -> list[Profile]:  # type: ignore[type-arg]
    """What the driver's parser makes of the mock's frames, each fed when its last byte has arrived."""
    parser, found = FrameParser(load_scanner("wide_xz").layout), list[Profile]()
    x = np.linspace(-0.07, 0.07, 1000)
    line_free_s = 0.0
    for number, time_s in enumerate(times_s):
        frame = wide_xz.encode(np.stack([x, 0.3 + 0.02 * np.sin(40 * x)], axis=1), number, DEVICE.device_time_s(time_s))
        ready_s = time_s + EXPOSURE_S / 2 + LATENCY_S + DEVICE.jitter_s * rng.random()
        line_free_s = max(line_free_s, ready_s) + len(frame) * 10 / BAUD
        found += parser.feed(frame, round((500.0 + line_free_s) * 1e9))
    return found


def worst_mm(scan: Scan, times_s: np.ndarray, at: Callable[[float], Pose] = flange) -> float:  # type: ignore[type-arg]
    """Largest error of a point of the cloud."""
    truth = replace(scan, T_base_flange=tuple(at(float(times_s[profile.sequence])) for profile in scan.profiles))
    gaps = np.linalg.norm(scan.to_cloud().points - truth.to_cloud().points, axis=1)
    return float(gaps.max()) * 1e3


EXPOSED_S = np.arange(0.5, 7.5, 1 / 70)
USUAL = Timing(latency_s=LEAST_DELAY_S)


@pytest.mark.parametrize("seed", range(5))
def test_timestamp_mode_stays_below_a_twentieth_of_a_millimetre(seed: int, record_property: Record) -> None:
    rng = np.random.default_rng(seed)
    scan = join(profiles(rng, EXPOSED_S), arm_states(rng), HAND_EYE, USUAL)
    error_mm = worst_mm(scan, EXPOSED_S)
    record_property("timestamp, mm", round(error_mm, 4))
    assert error_mm < 0.05


def test_a_shared_clock_leaves_next_to_nothing(record_property: Record) -> None:
    rng = np.random.default_rng(0)
    found = [replace(p, device_time_s=9000.0 + float(EXPOSED_S[p.sequence])) for p in profiles(rng, EXPOSED_S)]
    error_mm = worst_mm(join(found, arm_states(rng), HAND_EYE, Timing(shared_clock=True)), EXPOSED_S)
    record_property("shared clock, mm", round(error_mm, 5))
    assert error_mm < 0.001


@pytest.mark.parametrize("seed", range(5))
def test_trigger_mode_costs_no_more_than_a_control_cycle(seed: int, record_property: Record) -> None:
    """The exposure follows the edge at once; the edge is known to the cycle of 2 ms in which it is first seen."""
    rng = np.random.default_rng(seed)
    states = arm_states(rng)
    edges_s = np.array([b.device_time_s - 9000 for a, b in pairwise(states) if b.digital_outputs > a.digital_outputs])
    exposed_s = edges_s - rng.uniform(0.0, 1 / ARM_HZ, len(edges_s))
    found = profiles(rng, exposed_s)
    scan = scan_of(timed_by_trigger(found, states, 0, USUAL), HAND_EYE)
    error_mm = worst_mm(scan, exposed_s)
    record_property("trigger, mm", round(error_mm, 4))
    assert error_mm < SPEED_M_S / ARM_HZ * 1e3 + 0.001
    lost = [profile for profile in found if profile.sequence not in (20, 21, 90)]
    assert worst_mm(scan_of(timed_by_trigger(lost, states, 0, USUAL), HAND_EYE), exposed_s) == pytest.approx(error_mm)


def test_stop_and_go_does_not_depend_on_times(record_property: Record) -> None:
    """The arm rests for each profile: what is left is how it swings out, here 20 um falling off in 10 ms."""

    def at_rest(time_s: float) -> Pose:
        step, since_s = divmod(time_s, 0.2)
        return Pose.from_vector([0.4, 0.001 * step + 2e-5 * np.exp(-since_s / 0.01), 0.5, 0.0, 0.0, 0.0])

    rng = np.random.default_rng(0)
    exposed_s = np.arange(0.6, 7.4, 0.2) + 0.02
    found = profiles(rng, exposed_s)
    scan = Scan(tuple(found), tuple(at_rest(p.time_s - 500.0 + 0.1) for p in found), HAND_EYE)
    error_mm = worst_mm(scan, exposed_s, at_rest)
    record_property("stop and go, mm", round(error_mm, 4))
    assert error_mm < 0.02


def test_times_of_arrival_alone_would_not_do(record_property: Record) -> None:
    rng = np.random.default_rng(0)
    bare = [replace(profile, device_time_s=None) for profile in profiles(rng, EXPOSED_S)]
    error_mm = worst_mm(join(bare, arm_states(rng), HAND_EYE, USUAL), EXPOSED_S)
    record_property("arrival only, mm", round(error_mm, 4))
    assert error_mm > 0.08
