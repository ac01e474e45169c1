"""The blackboard: values, order, interpolation, and readers that never see a half-written record."""

from __future__ import annotations

import multiprocessing
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocks.world.blackboard import Blackboard, PlugState
from perception.geometry import Pose


class _Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_world_time_runs_scaled_from_creation_in_every_process(tmp_path: Path) -> None:
    clock = _Clock()
    board = Blackboard.create(tmp_path, 5.0, clock)
    clock.now = 102.0
    assert board.world_time_s() == pytest.approx(10.0)
    assert Blackboard.attach(tmp_path, clock).world_time_s() == pytest.approx(10.0)


def test_nothing_is_known_before_it_was_published(tmp_path: Path) -> None:
    board = Blackboard.create(tmp_path)
    assert board.arm_pose_at(0.0) is None and board.latest_arm() is None
    assert board.plug() == PlugState.away()
    assert (board.lock(), board.estop(), board.sweep()) == (False, False, 0)


def test_what_one_writes_another_reads(tmp_path: Path) -> None:
    board, other = Blackboard.create(tmp_path), Blackboard.attach(tmp_path)
    plug = PlugState(0.012, 0.001, -0.02, 0.03, True, 41.5)
    for writes in range(40):  # more than the ring holds
        board.put_plug(plug)
        board.put_lock(writes % 2 == 1)
    board.put_estop(True)
    board.put_sweep(3)
    assert other.plug() == plug
    assert (other.lock(), other.estop(), other.sweep()) == (True, True, 3)


def test_pose_between_two_samples_is_linear_and_slerp(tmp_path: Path) -> None:
    board = Blackboard.create(tmp_path)
    board.put_arm(1.0, Pose.from_rotvec([0, 0, 0.2], [0.0, 1.0, 0.0]).matrix)
    board.put_arm(2.0, Pose.from_rotvec([0, 0, 0.6], [0.4, 1.0, 0.0]).matrix)
    expected = Pose.from_rotvec([0, 0, 0.3], [0.1, 1.0, 0.0]).matrix
    assert board.arm_pose_at(1.25) == pytest.approx(expected)
    assert board.arm_pose_at(2.0) == pytest.approx(Pose.from_rotvec([0, 0, 0.6], [0.4, 1.0, 0.0]).matrix)
    assert board.arm_pose_at(0.99) is None and board.arm_pose_at(2.01) is None


@pytest.fixture(scope="module")
def travelled(tmp_path_factory: pytest.TempPathFactory) -> Blackboard:
    board = Blackboard.create(tmp_path_factory.mktemp("board"))
    for k in range(1001):
        board.put_arm(0.1 * k, Pose.from_rotvec([0, 0, 0.01 * k], [0.001 * k, 0, 0]).matrix)
    return board


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 99.9))
def test_any_time_within_the_samples_gives_the_pose_of_that_time(travelled: Blackboard, t: float) -> None:
    pose = travelled.arm_pose_at(t)
    assert pose is not None
    assert pose == pytest.approx(Pose.from_rotvec([0, 0, 0.1 * t], [0.01 * t, 0, 0]).matrix, abs=1e-6)


def test_samples_that_the_ring_has_overwritten_are_unknown(tmp_path: Path) -> None:
    board = Blackboard.create(tmp_path)
    pose = np.eye(4)
    for k in range(20_000):
        board.put_arm(0.002 * k, pose)
    assert board.arm_pose_at(1.0) is None
    assert board.arm_pose_at(39.0) is not None


def _write_pairs(folder: Path, stop: object) -> None:
    board = Blackboard.attach(folder)
    k = 0
    while not stop.is_set():  # type: ignore[attr-defined]
        k += 1
        board.put_plug(PlugState(k, k, k, k, False, k))


def test_a_reader_never_sees_a_half_written_value(tmp_path: Path) -> None:
    board = Blackboard.create(tmp_path)
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    writer = context.Process(target=_write_pairs, args=(tmp_path, stop))
    writer.start()
    try:
        seen, deadline = 0.0, time.monotonic() + 30.0
        changes = 0
        while changes < 300 and time.monotonic() < deadline:
            plug = board.plug()
            if plug == PlugState.away():
                continue
            assert plug.depth_m == plug.lateral_m == plug.roll_rad == plug.tilt_rad == plug.force_n
            assert plug.depth_m >= seen
            changes += plug.depth_m > seen
            seen = plug.depth_m
        assert changes == 300
    finally:
        stop.set()
        writer.join(10.0)


def test_a_record_broken_by_a_killed_writer_is_not_believed(tmp_path: Path) -> None:
    board = Blackboard.create(tmp_path)
    board.put_sweep(1)
    section = board._sweep
    start = section._start(1) + 8
    board._memory[start : start + 4] = b"\xff\xff\xff\xff"
    assert section.at(1) is None


def test_a_file_that_is_no_blackboard_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Blackboard.attach(tmp_path)
    (tmp_path / "blackboard").write_bytes(bytes(4096))
    with pytest.raises(ValueError, match="not a blackboard"):
        Blackboard.attach(tmp_path)


def test_the_next_car_is_known_by_its_number_and_its_place(tmp_path: Path) -> None:
    board, other = Blackboard.create(tmp_path), Blackboard.attach(tmp_path)
    assert (other.cars(), other.car()) == (0, None)
    for car in range(1, 40):  # more than the ring holds
        board.put_car((0.9, 0.1, 0.4, 0.0, 0.0, 0.01 * car))
        assert (other.cars(), other.car()) == (car, (0.9, 0.1, 0.4, 0.0, 0.0, 0.01 * car))
    board.put_arm(1.0, np.eye(4))
    board.put_edge(1.0, 2)
    assert other.cars() == 39 and other.latest_arm() is not None, "its section is no other's"
