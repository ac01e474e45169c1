"""Where a mission waits for the world: a pause before contact, and the end of power when the process ends docked."""

from __future__ import annotations

import logging

from controller.faults import Fault, FaultCode, MissionFault
from controller.states import Event
from controller.task import Task
from controller.undocking import switch_off

log = logging.getLogger(__name__)

NO_AXIS = Fault(FaultCode.AXIS_UNKNOWN, "the plug was found inserted and no insertion is stored; the charge goes on")


def hold(task: Task) -> Event:
    """Wait until the reason for the pause is gone, then start over at staging."""
    supervisor = task.cell.supervisor
    while True:
        if not supervisor.wait(lambda: supervisor.pause is None, task.config.deadlines.hold_s):
            raise MissionFault(FaultCode.DEADLINE, "the pause lasted too long")
        try:
            task.cell.recover_arm()
        except MissionFault:
            if supervisor.trip is not None or supervisor.pause is None:
                raise
            continue  # somebody has stepped back into the zone meanwhile
        return Event.RESUMED


def leave_docked(task: Task) -> Event:
    """The process ends while docked: power off, the plug stays locked, nothing moves."""
    if not switch_off(task, task.config.deadlines.releasing_s / 3.0):
        log.error("the process ends, but current or contactor did not go off; the plug stays locked")
    return Event.SHUT_DOWN
