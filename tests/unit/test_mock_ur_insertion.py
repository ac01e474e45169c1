"""The emulated arm pushes the plug in force mode: the outcome is the one predicted from the misalignment alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocks.ur.arm import Arm, ForceMode, Sensor
from mocks.ur.environment import PortEnvironment
from mocks.ur.kinematics import MODELS, Kinematics
from mocks.world import contact
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Pose

T_BASE_PORT = Pose.from_vector([0.95, 0.1, 0.45, *np.deg2rad([69.2820323, -69.2820323, -69.2820323])])
T_PORT_TCP = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.049]))
T_FLANGE_TCP = Pose.from_vector([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
DT = 0.008
PUSH_N = 60.0


def _arm(board: Blackboard, error: Pose, rng: np.random.Generator, blocked_depth_m: float | None) -> Arm:
    """An arm with the plug 5 mm in front of the rim plane, off by ``error`` in port axes."""
    world = WorldSpec(
        seed=0,
        port="ccs2",
        T_base_port=tuple(T_BASE_PORT.vector),  # type: ignore[arg-type]
        T_flange_scanner=(0.0,) * 6,  # type: ignore[arg-type]
        T_flange_tcp=tuple(T_FLANGE_TCP.vector),  # type: ignore[arg-type]
        T_port_tcp=tuple(T_PORT_TCP.vector),  # type: ignore[arg-type]
        blocked_depth_m=blocked_depth_m,
    )
    start = Pose(error.rotation @ T_PORT_TCP.rotation, error.translation + np.array([0.0, 0.0, 0.005]))
    kinematics = Kinematics(MODELS["ur10e"])
    flange = (T_BASE_PORT @ start @ T_FLANGE_TCP.inverse()).matrix
    q = kinematics.inverse(flange, np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0]))
    assert q is not None
    arm = Arm(kinematics, q, PortEnvironment(world, board), Sensor(rng, 0.3, 0.01, 3.0, 0.1))
    arm.set_tcp(T_FLANGE_TCP.matrix)
    for _ in range(30):
        arm.step(DT)
    arm.sensor.zero()
    return arm


def _push(arm: Arm, board: Blackboard) -> float:
    """Push until the depth has not changed for a second (emulated); returns the largest contact force."""
    task = Pose(T_BASE_PORT.rotation @ np.diag([1.0, -1.0, -1.0]), T_BASE_PORT.translation)
    limits = np.array([0.01, 0.01, 0.015, 0.05, 0.05, 0.05])
    arm.enter_force_mode(ForceMode(task.matrix, (True,) * 6, np.array([0.0, 0.0, PUSH_N, 0.0, 0.0, 0.0]), limits))
    arm.force_gain = 0.5
    peak, mark, still = 0.0, -1.0, 0
    while still < 125:
        arm.step(DT)
        peak = max(peak, float(np.linalg.norm(arm.true_wrench[:3])))
        depth = board.plug().depth_m
        still = still + 1 if abs(depth - mark) < 0.0003 else 0
        mark = mark if still else depth
    return peak


def _misalignment(rng: np.random.Generator, spread: float) -> Pose:
    """Within and beyond capture, but not so close to its limits that the sensor's noise decides."""
    while True:
        lateral_mm, tilt_deg = spread * rng.uniform(-2.4, 2.4, 2), spread * rng.uniform(-2.1, 2.1, 2)
        roll_deg = spread * rng.uniform(-3.3, 3.3)
        gaps = (np.linalg.norm(lateral_mm) - 2.5, np.linalg.norm(tilt_deg) - 2.5, abs(roll_deg) - 3.0)
        if min(abs(gap) for gap in gaps) > 0.15:
            return Pose.from_rotvec(np.deg2rad([*tilt_deg, roll_deg]), [*(lateral_mm / 1000.0), 0.0])


def _insert(board: Blackboard, rng: np.random.Generator, spread: float) -> tuple[bool, bool, float]:
    """One insertion: predicted and actual success, peak force."""
    error = _misalignment(rng, spread)
    blocked = 0.02 if rng.uniform() < 0.1 else None
    port = contact.Port(T_PORT_TCP, blocked_depth_m=blocked)
    arm = _arm(board, error, rng, blocked)
    T_port_tcp = T_BASE_PORT.inverse().matrix @ arm.reference.T_base_tcp
    predicted = contact.predict_outcome(contact.misalignment(T_port_tcp, port), port) == "mates"
    peak = _push(arm, board)
    return predicted, board.plug().seated, peak


def _campaign(board: Blackboard, count: int, spread: float = 1.0) -> list[tuple[bool, bool, float]]:
    rng = np.random.default_rng(11)
    return [_insert(board, rng, spread) for _ in range(count)]


def _judge(results: list[tuple[bool, bool, float]]) -> None:
    assert [seated for _, seated, _ in results] == [predicted for predicted, _, _ in results]
    assert max(peak for _, _, peak in results) < 1.1 * PUSH_N


def test_insertions_end_as_predicted(tmp_path) -> None:
    results = _campaign(Blackboard.create(tmp_path), 6)
    _judge(results)
    assert {predicted for predicted, _, _ in results} == {True, False}


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_three_hundred_insertions_end_as_predicted(tmp_path) -> None:
    results = _campaign(Blackboard.create(tmp_path), 300, spread=1.12)
    _judge(results)
    assert 0.3 < sum(predicted for predicted, _, _ in results) / len(results) < 0.7


def test_when_another_car_parks_the_plug_meets_its_port_and_not_the_one_before(tmp_path: Path) -> None:
    board, rng = Blackboard.create(tmp_path), np.random.default_rng(4)
    arm = _arm(board, Pose.identity(), rng, None)
    aside = T_BASE_PORT @ Pose.from_rotvec([0.0, 0.0, 0.0], [0.02, 0.0, 0.0])
    board.put_car(tuple(aside.vector))
    _push(arm, board)
    assert not board.plug().seated and board.plug().lateral_m == pytest.approx(0.02, abs=0.003)
    board.put_car(tuple(T_BASE_PORT.vector))
    arm = _arm(board, Pose.identity(), rng, None)
    _push(arm, board)
    assert board.plug().seated
