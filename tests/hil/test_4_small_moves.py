"""Stage 4, small moves at 10 % speed: 20 mm back along the tool's axis and again, a stop, an abort.

Every command passes the gate, as in a mission.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from controller.assembly import Assembly
from controller.commands import MoveLinear, StopMotion
from controller.faults import MissionFault
from controller.states import State
from perception.geometry import Pose
from tests.hil.bench import Bench
from tests.hil.conftest import Announce

SHARE = 0.1
BACK_M = 0.020
PATIENCE_S = 60.0


@pytest.fixture
def staged(live: Assembly) -> Iterator[Assembly]:
    """In STAGING, where the gate lets the arm move freely; at rest again afterwards."""
    supervisor = live.cell.supervisor
    supervisor.enter(State.SELF_CHECK, None)
    supervisor.wait(lambda: live.cell.charger_says(lambda s: not s.motion_inhibit), PATIENCE_S)
    supervisor.enter(State.STAGING, PATIENCE_S)
    yield live
    live.cell.do(StopMotion())
    supervisor.enter(State.OFFLINE, None)
    supervisor.reset()


def back(live: Assembly, bench: Bench, distance_m: float = BACK_M) -> MoveLinear:
    """Away from whatever the tool points at, slowly."""
    motion = bench.config.motion
    target = live.cell.arm.state().T_base_tcp @ Pose(np.eye(3), np.array([0.0, 0.0, -distance_m]))
    return MoveLinear(target, SHARE * motion.linear_speed_mm_s / 1000.0, SHARE * motion.acceleration_mm_s2 / 1000.0)


def test_20_mm_back_and_again(staged: Assembly, bench: Bench, announce: Announce) -> None:
    announce("The arm will move its tool 20 mm backwards along the tool's axis at 10 % speed, and return.")
    start = staged.cell.arm.state().T_base_tcp
    there = back(staged, bench)
    for target in (there.T_base_tcp, start):
        staged.cell.travel(MoveLinear(target, there.speed_m_s, there.acceleration_m_s2), PATIENCE_S)
        staged.cell.settle(0.001, PATIENCE_S)
        reached = staged.cell.arm.state().T_base_tcp
        assert reached.distance_to(target) < 0.001 and reached.angle_to(target) < np.deg2rad(0.2)


def test_a_stop_ends_a_motion_on_its_way(staged: Assembly, bench: Bench, announce: Announce) -> None:
    announce("The arm will begin to move its tool 20 mm backwards at 10 % speed and be stopped on its way.")
    cell, command = staged.cell, back(staged, bench)
    start = cell.arm.state().T_base_tcp
    cell.do(command)
    assert cell.supervisor.wait(lambda: cell.arm.state().T_base_tcp.distance_to(start) > 0.002, PATIENCE_S)
    cell.do(StopMotion())
    cell.settle(0.001, PATIENCE_S)
    assert cell.arm.state().T_base_tcp.distance_to(start) < BACK_M - 0.002


def test_an_abort_stops_the_arm_and_latches(staged: Assembly, bench: Bench, announce: Announce) -> None:
    announce("The arm will begin to move its tool 20 mm backwards at 10 % speed; an abort will stop it on its way.")
    cell, command = staged.cell, back(staged, bench)
    start = cell.arm.state().T_base_tcp
    cell.do(command)
    assert cell.supervisor.wait(lambda: cell.arm.state().T_base_tcp.distance_to(start) > 0.002, PATIENCE_S)
    cell.supervisor.request_abort()
    with pytest.raises(MissionFault, match="aborted"):
        cell.supervisor.wait(lambda: False, PATIENCE_S)
    cell.supervisor.forget_requests()
    cell.supervisor.reset()
    cell.supervisor.enter(State.OFFLINE, None)
    assert cell.supervisor.wait(lambda: np.abs(cell.arm.state().tcp_speed[:3]).max() < 0.001, PATIENCE_S)
    assert cell.arm.state().T_base_tcp.distance_to(start) < BACK_M - 0.002


def test_the_gate_refuses_what_is_outside_the_workspace(staged: Assembly) -> None:
    far = Pose(np.eye(3), np.array([5.0, 0.0, 0.5]))
    with pytest.raises(MissionFault, match="workspace"):
        staged.cell.do(MoveLinear(far, 0.01, 0.05))
