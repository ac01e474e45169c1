"""What the arm still does when the charger falls silent before contact: back out on the axis it approached on.

Only here: before the vehicle, out of contact and with the arm in order. Everywhere else the arm stops where it is,
since a silent charger may have a live plug. FAULT is entered when the motion has ended, however it ends.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from controller.commands import BackOff
from controller.self_check import before_port
from controller.situation import STILL_M_S
from controller.task import Task
from perception.errors import PortdockError

log = logging.getLogger(__name__)
_COME_TO_REST_S = 2.0


def back_off(task: Task) -> None:
    """Out to the plan's retreat pose if the gate allows it; otherwise stay. Never raises."""
    plan, cell = task.plan, task.cell
    if plan is None or not before_port(plan, cell.arm_state(), task.config.motion):
        return
    motion = task.config.motion
    command = BackOff(plan.retreat, motion.approach_speed_mm_s / 1000.0, motion.acceleration_mm_s2 / 1000.0)
    with cell.supervisor.backing_off() as allowed:
        try:
            _wait(task, _COME_TO_REST_S, lambda: _at_rest(task) or not allowed())
            cell.do(command)
            _wait(task, task.config.deadlines.approaching_s, lambda: not cell.arm.motion().running or not allowed())
        except PortdockError as error:
            log.warning("the arm stays where it is: %s", error)


def _wait(task: Task, longest_s: float, until: Callable[[], bool]) -> None:
    """Whatever is latched."""
    end_s = task.cell.clock.now_s() + longest_s
    task.cell.supervisor.idle(lambda: until() or task.cell.clock.now_s() > end_s)


def _at_rest(task: Task) -> bool:
    arm = task.cell.arm_state()
    return arm is not None and not arm.moving and float(abs(arm.tcp_speed[:3]).max()) < STILL_M_S
