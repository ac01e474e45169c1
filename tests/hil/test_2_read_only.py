"""Stage 2, read-only: what the devices say while they are left alone. Nothing moves, no laser, no power."""

from __future__ import annotations

import itertools

import numpy as np

from controller.assembly import Assembly
from drivers.base import Proximity, RobotMode, SafetyMode
from tests.hil.bench import Bench
from tests.hil.patience import until


def test_the_arm_tells_its_state_at_the_configured_rate_and_in_order(live: Assembly, bench: Bench) -> None:
    arm = live.cell.arm
    begin_s = live.cell.wall.now_s()
    until(lambda: len(arm.history(begin_s)) >= 200, "200 arm states")
    states = arm.history(begin_s)
    steps_s = [b.device_time_s - a.device_time_s for a, b in itertools.pairwise(states)]
    assert min(steps_s) > 0.0
    slack = 20.0 if "arm" in bench.mocked else 1.5  # a mock shares its processors with everything else
    assert np.median(steps_s) < slack / bench.config.arm.frequency_hz


def test_the_arm_is_ready_and_at_rest_with_the_configured_tool(live: Assembly, bench: Bench) -> None:
    state = live.cell.arm.state()
    assert state.mode is RobotMode.RUNNING and state.safety in (SafetyMode.NORMAL, SafetyMode.REDUCED)
    assert not state.moving and np.abs(state.tcp_speed).max() < 0.01
    assert state.T_flange_tcp.distance_to(bench.config.arm.T_flange_tcp.pose) < 1e-4


def test_the_force_sensor_is_quiet(live: Assembly) -> None:
    """The spread, not the value: zeroing is the self check's, and only with no plug inserted."""
    begin_s = live.cell.wall.now_s()
    until(lambda: len(live.cell.arm.history(begin_s)) >= 100, "100 arm states")
    forces = np.array([state.wrench[:3] for state in live.cell.arm.history(begin_s)])
    assert np.ptp(forces, axis=0).max() < 15.0, "check the payload, and that nothing touches the tool"


def test_the_charger_hears_the_heartbeat_and_senses_no_plug(live: Assembly) -> None:
    charger = live.cell.charger
    until(lambda: not charger.status().motion_inhibit, "the charger permits motion")
    status = charger.status()
    assert status.proximity is Proximity.ABSENT, "take the plug out of the port before the bench tests"
    assert not status.contactor_closed and not status.estop


def test_no_link_counts_damage(live: Assembly) -> None:
    for name, health in live.cell.healths():
        counters = dict(health.counters)
        assert counters.get("bad_checksum", 0) == 0, (name, counters)
