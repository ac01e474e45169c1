"""Stage 5, free-air docking: the poses of a docking, set back from the expected port so far that nothing can touch.

At 10 % speed: to staging, retreat, pre-contact, home, and back to retreat.
"""

from __future__ import annotations

import numpy as np

from controller.assembly import Assembly
from controller.commands import MoveJoints, MoveLinear, StopMotion
from controller.looking import Looking
from controller.planning import plan_on_axis
from controller.states import State
from perception.geometry import Pose
from tests.hil.bench import Bench
from tests.hil.conftest import Announce

SHARE = 0.1
BACK_M = 0.120
"""The whole docking is done this far in front of the expected port; the car may stand 30 mm nearer than expected."""
PATIENCE_S = 180.0


def test_a_docking_in_free_air(live: Assembly, bench: Bench, announce: Announce) -> None:
    announce(
        "The arm will go to the scan's start, then make a whole docking motion at 10 % speed,"
        f" {BACK_M * 1000:.0f} mm in front of where the site file expects the port."
    )
    cell, motion = live.cell, bench.config.motion
    cell.supervisor.enter(State.SELF_CHECK, None)
    assert cell.supervisor.wait(lambda: cell.charger_says(lambda s: not s.motion_inhibit), 30.0)
    speed, acceleration = SHARE * motion.linear_speed_mm_s / 1000.0, SHARE * motion.acceleration_mm_s2 / 1000.0
    turn, turn_up = np.deg2rad([SHARE * motion.joint_speed_deg_s, SHARE * motion.joint_acceleration_deg_s2])
    in_air = bench.config.port.T_base_port.pose @ Pose(np.eye(3), np.array([0.0, 0.0, BACK_M]))
    plan = plan_on_axis(in_air, live.T_port_tcp_mated, motion)
    assert cell.reach([plan.retreat, plan.pre_contact, plan.mated]) is None

    cell.supervisor.enter(State.STAGING, None)
    start = Looking(cell, bench.config).viewpoint().T_base_tcp_start
    cell.travel(MoveJoints(start, float(turn), float(turn_up)), PATIENCE_S)
    cell.supervisor.enter(State.APPROACHING, None)
    try:
        for target in (plan.retreat, plan.pre_contact, plan.mated, plan.retreat):
            cell.travel(MoveLinear(target, speed, acceleration), PATIENCE_S)
            cell.settle(0.001, PATIENCE_S)
            assert cell.arm.state().T_base_tcp.distance_to(target) < 0.001
            assert np.linalg.norm(cell.arm.state().wrench[:3]) < 30.0, (
                "something touches the tool, or the payload is off"
            )
    finally:
        cell.do(StopMotion())
        cell.supervisor.enter(State.OFFLINE, None)
