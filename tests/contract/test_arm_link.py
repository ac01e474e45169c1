"""The arm driver and a controller at the far end of real sockets: motions end where they were sent, stops stop.

One controller and one driver serve the tests that leave them as they found them.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from drivers.arm.errors import (
    ArmBusyError,
    CollisionError,
    InvalidCommandError,
    ProgramStoppedError,
    UnreachableError,
)
from drivers.base import Box, Compliance, RobotMode, SafetyMode
from perception.geometry import Pose
from tests.arm_rig import COG_M, PAYLOAD_KG, T_FLANGE_TCP, Rig, until


@pytest.fixture(scope="module")
def rig():
    made = Rig()
    yield made
    made.close()


@pytest.fixture(autouse=True)
def ready(rig):
    """Every test begins with the script running and the arm at rest."""
    rig.kicker.resume()
    if not rig.arm.state().program_running:
        rig.arm.recover()
    rig.arm.stop(2.0)
    until(lambda: not rig.arm.state().moving, "the arm rests")
    rig.arm.set_obstacles(())
    yield
    rig.arm.stop(2.0)


def push(rig: Rig, force_n: float = 10.0) -> Compliance:
    """Compliant along the TCP's z, where it is now."""
    selection = (False, False, True, False, False, False)
    wrench = (0.0, 0.0, force_n, 0.0, 0.0, 0.0)
    return Compliance(rig.arm.state().T_base_tcp, selection, wrench, (0.02,) * 6)


def test_state_is_what_the_controller_does(rig) -> None:
    state, truth = rig.arm.state(), rig.mock.state()
    assert state.joints == pytest.approx(truth["q"], abs=1e-6)
    assert state.T_base_tcp.distance_to(Pose.from_vector(truth["tcp"])) < 1e-6
    assert state.T_flange_tcp is T_FLANGE_TCP
    assert (state.mode, state.safety) == (RobotMode.RUNNING, SafetyMode.NORMAL)
    assert state.program_running
    assert not state.moving
    assert state.speed_scaling == 1.0


def test_payload_and_tcp_are_the_configured_ones(rig) -> None:
    mass, cog = rig.arm._links.telemetry.payload()
    assert mass == pytest.approx(PAYLOAD_KG)
    assert cog == pytest.approx(COG_M)


def test_samples_come_at_the_links_rate_by_the_controllers_clock(rig) -> None:
    begun = rig.arm.state()
    until(lambda: rig.arm.state().device_time_s > begun.device_time_s + 1.0, "a second of emulated time passes")
    samples = rig.arm.history(begun.time_s)
    steps = np.diff([sample.device_time_s for sample in samples])
    assert (steps > 0).all()
    assert len(samples) > 0.8 * 125  # the machine may be busy; 125 is nominal
    assert rig.sink.states[-1].device_time_s >= samples[-1].device_time_s


def test_a_straight_motion_ends_at_its_target(rig) -> None:
    start = rig.arm.state().T_base_tcp
    target = start.moved([0.02, 0.01, -0.05])
    progress = rig.finish(rig.arm.move_linear(target, 0.2, 1.0))
    assert not progress.failed, progress.detail
    reached = Pose.from_vector(rig.mock.state()["tcp"])
    assert reached.distance_to(target) < 1e-4
    assert reached.angle_to(target) < 1e-3
    times = [sample.T_base_tcp.translation for sample in rig.sink.states[-40:]]
    direction = (target.translation - start.translation) / target.distance_to(start)
    off_line = [np.linalg.norm(np.cross(direction, point - start.translation)) for point in times]
    assert max(off_line) < 1e-3


def test_a_joint_motion_ends_at_its_target_on_the_nearest_branch(rig) -> None:
    before = rig.arm.state()
    target = before.T_base_tcp @ Pose.from_vector([0.0, 0.05, 0.05, 0.1, 0.0, 0.1])
    progress = rig.finish(rig.arm.move_joints(target, 0.8, 2.0))
    assert not progress.failed, progress.detail
    after = rig.arm.state()
    assert after.T_base_tcp.distance_to(target) < 1e-4
    assert np.abs(after.joints - before.joints).max() < 0.5


def test_a_velocity_lasts_until_stopped_and_kicks_do_not_wipe_it_out(rig) -> None:
    start = rig.arm.state()
    rig.arm.move_velocity(np.array([0.0, 0.0, 0.03, 0.0, 0.0, 0.0]), 0.5)
    until(lambda: rig.arm.state().T_base_tcp.translation[2] > start.T_base_tcp.translation[2] + 0.015, "it rises")
    assert rig.arm.state().tcp_speed[2] == pytest.approx(0.03, abs=0.002)
    rig.arm.move_velocity(np.array([0.0, 0.0, -0.02, 0.0, 0.0, 0.0]), 0.5)
    until(lambda: rig.arm.state().tcp_speed[2] < -0.018, "the velocity changes")
    rig.arm.stop(1.0)
    rig.mock.until_still()
    assert rig.arm.state().program_running


def test_a_stop_from_speed_takes_the_distance_that_its_deceleration_says(rig) -> None:
    rig.arm.move_velocity(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]), 1.0)
    until(lambda: rig.arm.state().tcp_speed[2] > 0.099, "it is at speed")
    asked = rig.arm.state()
    rig.arm.stop(0.5)
    rig.mock.until_still()
    samples = rig.arm.history(asked.time_s)
    slowing = [sample for sample in samples if 0.005 < sample.tcp_speed[2] < 0.095]
    assert len(slowing) >= 2, "it stopped dead instead of decelerating"
    times, speeds = (np.diff([one.device_time_s for one in slowing]), np.diff([one.tcp_speed[2] for one in slowing]))
    rate = float(np.median(-speeds / times))  # single steps: a mock that is late leaves some time out
    assert rate == pytest.approx(0.5, rel=0.3)
    assert rig.arm.state().program_running


def test_stop_in_the_middle_of_a_motion_says_so_and_the_next_motion_works(rig) -> None:
    start = rig.arm.state().T_base_tcp
    first = rig.arm.move_linear(start.moved([0.0, 0.0, -0.1]), 0.05, 0.5)
    rig.until_moving()
    rig.arm.stop(1.0)
    second = rig.arm.move_linear(start, 0.2, 1.0)  # waits for the stop, then goes
    progress = rig.finish(second)
    assert not progress.failed, progress.detail
    assert second == first + 1


def test_a_stopped_motion_is_reported_as_failed(rig) -> None:
    start = rig.arm.state().T_base_tcp
    motion = rig.arm.move_linear(start.moved([0.0, 0.0, -0.1]), 0.05, 0.5)
    rig.until_moving()
    rig.arm.stop(1.0)
    progress = rig.finish(motion)
    assert progress.failed
    assert progress.detail == "stopped on the way"


def test_force_mode_begins_and_ends(rig) -> None:
    rig.arm.comply(push(rig))
    until(lambda: rig.mock.state()["force_mode"], "the controller is in force mode")
    rig.arm.stop()
    until(lambda: not rig.mock.state()["force_mode"], "force mode ends")
    rig.mock.until_still()
    assert rig.arm.state().program_running


def test_sideways_velocity_within_force_mode_and_one_stop_for_both(rig) -> None:
    rig.arm.comply(push(rig, 2.0))
    rig.arm.move_velocity(np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0]), 0.5)
    until(lambda: rig.mock.state()["force_mode"] and rig.arm.state().tcp_speed[1] > 0.008, "both are active")
    rig.arm.stop()
    until(lambda: not rig.mock.state()["force_mode"], "force mode ends")
    rig.mock.until_still()


def test_a_stop_at_rest_is_no_error_and_ends_nothing(rig) -> None:
    for _ in range(3):
        rig.arm.stop()
    assert rig.arm.state().program_running


def test_the_force_sensor_is_zeroed_at_rest_only(rig) -> None:
    rig.arm.zero_force_sensor()
    rig.arm.move_velocity(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]), 0.5)
    rig.until_moving()
    with pytest.raises(InvalidCommandError, match="moves"):
        rig.arm.zero_force_sensor()


def test_without_kicks_the_controller_stops_the_program_and_the_arm(rig) -> None:
    rig.arm.move_velocity(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]), 0.5)
    rig.until_moving()
    rig.kicker.pause()
    rig.mock.until_still()
    assert rig.mock.state()["program"] is None
    until(lambda: not rig.arm.state().program_running, "the state tells")
    with pytest.raises(ProgramStoppedError):
        rig.arm.move_velocity(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]), 0.5)


def test_after_the_watchdog_recover_makes_the_arm_usable_and_nothing_goes_on(rig) -> None:
    motion = rig.arm.move_linear(rig.arm.state().T_base_tcp.moved([0, 0, -0.1]), 0.05, 0.5)
    rig.until_moving()
    rig.kicker.pause()
    progress = rig.finish(motion)
    assert progress.failed
    rig.kicker.resume()
    rig.arm.recover()
    rig.mock.until_still()
    assert not rig.finish(rig.arm.move_linear(rig.arm.state().T_base_tcp.moved([0, 0, 0.02]), 0.1, 0.5)).failed


def test_a_second_motion_is_refused_while_one_runs(rig) -> None:
    start = rig.arm.state().T_base_tcp
    rig.arm.move_linear(start.moved([0.0, 0.0, -0.1]), 0.05, 0.5)
    with pytest.raises(ArmBusyError):
        rig.arm.move_linear(start, 0.05, 0.5)


def test_commands_with_bad_numbers_never_reach_the_controller(rig) -> None:
    start = rig.arm.state().T_base_tcp
    sent = len(rig.sink.commands)
    with pytest.raises(InvalidCommandError, match="6 values"):
        rig.arm.move_velocity(np.zeros(5), 0.5)
    with pytest.raises(InvalidCommandError, match="not finite"):
        rig.arm.move_velocity(np.full(6, np.nan), 0.5)
    with pytest.raises(InvalidCommandError, match="above"):
        rig.arm.move_velocity(np.array([3.0, 0, 0, 0, 0, 0]), 0.5)
    for speed in (0.0, -1.0, 9.0, float("nan")):
        with pytest.raises(InvalidCommandError, match="speed"):
            rig.arm.move_linear(start, speed, 0.5)
        with pytest.raises(InvalidCommandError, match="speed"):
            rig.arm.move_joints(start, speed, 0.5)
    with pytest.raises(InvalidCommandError, match="acceleration"):
        rig.arm.move_linear(start, 0.1, 99.0)
    with pytest.raises(InvalidCommandError, match="not finite"):
        rig.arm.move_linear(Pose(np.eye(3), np.array([np.inf, 0, 0])), 0.1, 0.5)
    with pytest.raises(InvalidCommandError, match="deceleration"):
        rig.arm.stop(0.0)
    assert len(rig.sink.commands) == sent


def test_force_mode_beyond_its_caps_is_refused(rig) -> None:
    with pytest.raises(InvalidCommandError, match="wrench"):
        rig.arm.comply(push(rig, 500.0))
    fast = push(rig)
    with pytest.raises(InvalidCommandError, match="compliant axis"):
        rig.arm.comply(Compliance(fast.T_base_task, fast.selection, fast.wrench, (1.5,) * 6))


def test_a_target_out_of_reach_is_refused_before_it_can_kill_the_script(rig) -> None:
    start = rig.arm.state().T_base_tcp
    far = Pose(start.rotation, start.translation * 4.0)
    with pytest.raises(UnreachableError):
        rig.arm.move_linear(far, 0.1, 0.5)
    with pytest.raises(UnreachableError):
        rig.arm.move_joints(far, 0.5, 0.5)
    assert rig.arm.state().program_running


def test_a_way_through_a_seen_box_is_refused(rig) -> None:
    start = rig.arm.state().T_base_tcp
    target = start.moved([0.0, 0.0, 0.2])
    box = Box("cover", start.moved([0.0, 0.0, 0.15]), (0.05, 0.05, 0.02))
    rig.arm.set_obstacles((box,))
    with pytest.raises(CollisionError, match="cover"):
        rig.arm.move_linear(target, 0.1, 0.5)


def test_commands_and_their_results_reach_the_recorder(rig) -> None:
    begun = time.monotonic()
    target = rig.arm.state().T_base_tcp.moved([0.0, 0.0, -0.02])
    rig.finish(rig.arm.move_linear(target, 0.1, 0.5))
    record = next(one for one in rig.sink.commands if one.time_s > begun)
    assert record.name == "move_linear"
    assert record.arguments == pytest.approx((*target.vector, 0.1, 0.5))
    assert record.result == "ok"
