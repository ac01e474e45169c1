"""Pulling out: power off, lock open, a bounded pull along the axis that was inserted on, clear of the vehicle.

Each condition is seen in frames that came after what should have brought it about; nothing is inferred from a
request's answer. A plug that does not come is left where it is: the arm never pulls harder by itself.
"""

from __future__ import annotations

from collections.abc import Callable

from controller.commands import Announce, AskCharger, MoveLinear, StopMotion
from controller.durable import forget_insertion
from controller.faults import FaultCode, MissionFault
from controller.planning import DockPlan
from controller.safety import plug_inserted
from controller.self_check import OFF_AXIS_M
from controller.situation import LIVE_CURRENT_A
from controller.states import Event
from controller.task import Task
from controller.withdrawal import withdraw
from drivers.base import ChargerRequest, ChargerStatus, PlugLock, Proximity


def release(task: Task) -> Event:
    """Power off, current gone, contactor open, lock open: each seen freshly, in this order."""
    cell, patience_s = task.cell, task.config.deadlines.releasing_s / 3.0
    cell.do(StopMotion())
    if not switch_off(task, patience_s):
        raise MissionFault(FaultCode.RELEASE_FAILED, "current or contactor did not go off")
    asked_s = cell.wall.now_s()
    cell.ask(ChargerRequest.UNLOCK_PLUG, patience_s)
    if not _seen(task, asked_s, lambda s: s.lock is PlugLock.UNLOCKED, patience_s):
        raise MissionFault(FaultCode.RELEASE_FAILED, "the lock did not open")
    return Event.RELEASED


def switch_off(task: Task, patience_s: float) -> bool:
    """Ask for the end of power; whether fresh frames then show no current and an open contactor."""
    asked_s = task.cell.wall.now_s()
    task.cell.do(AskCharger(ChargerRequest.STOP_POWER))
    return _seen(
        task,
        asked_s,
        lambda s: not s.contactor_closed and abs(s.current_a) < LIVE_CURRENT_A and s.electrical_time_s > asked_s,
        patience_s,
    )


def retreat(task: Task) -> Event:
    """Out along the axis that was inserted on, then clear of the vehicle."""
    cell, insertion = task.cell, task.config.insertion_here
    patience_s = task.config.deadlines.retreating_s
    cell.do(StopMotion())
    plan = _known_axis(task)
    _refuse_if_locked(task)
    withdraw(cell, plan, insertion, patience_s)
    if not cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.proximity is Proximity.ABSENT), patience_s / 2.0):
        raise MissionFault(FaultCode.WITHDRAWAL_BLOCKED, "the plug is out, but the proximity contact still reports it")
    speed, acceleration = insertion.withdraw_speed_mm_s / 1000.0, task.config.motion.acceleration_mm_s2 / 1000.0
    cell.travel(MoveLinear(plan.retreat, speed, acceleration), patience_s)
    _forget(task)
    return _next_rung(task)


def _known_axis(task: Task) -> DockPlan:
    """The plan whose axis the inserted plug is on. Raises MissionFault (axis-unknown)."""
    plan, arm = task.plan, task.cell.arm_state()
    if plan is None:
        raise MissionFault(FaultCode.AXIS_UNKNOWN, "power is off and the lock open, but no insertion is stored")
    sensed = not task.cell.charger_says(lambda s: s.proximity is Proximity.ABSENT)
    if sensed and (arm is None or plan.lateral_m(arm.T_base_tcp) > OFF_AXIS_M):
        raise MissionFault(FaultCode.AXIS_UNKNOWN, "the arm does not stand on the stored insertion axis")
    return plan


def _refuse_if_locked(task: Task) -> None:
    """A lock that jammed, on its way shut too, needs a person. Raises MissionFault (release-failed)."""
    now = task.cell.situation()
    if now.charger is not None and now.charger.lock is not PlugLock.UNLOCKED and plug_inserted(now):
        lock = now.charger.lock.name.lower()
        raise MissionFault(FaultCode.RELEASE_FAILED, f"the plug's lock is {lock}: what may be locked is not pulled")


def _forget(task: Task) -> None:
    """The plug is out and the arm clear of the vehicle."""
    forget_insertion(task.state_folder)
    task.plan, task.cell.T_base_port = None, None
    task.cell.supervisor.facts.mated = False
    task.cell.supervisor.facts.clear_of_vehicle = True
    task.cell.do(Announce(None))


def _next_rung(task: Task) -> Event:
    """Another attempt, or the end."""
    now = task.now
    final = now.setback is None or now.setback.code is FaultCode.NOT_CHARGING or task.last_attempt
    if final or now.stopping:
        return Event.RETREATED
    now.attempt += 1
    if task.last_attempt:
        task.looking.forget_scans()
    return Event.RETREATED_TO_RETRY


def _seen(task: Task, since_s: float, wanted: Callable[[ChargerStatus], bool], patience_s: float) -> bool:
    """Whether a status received after ``since_s`` fulfils ``wanted``."""
    cell = task.cell
    return cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.time_s > since_s and wanted(s)), patience_s)
