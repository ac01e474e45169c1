"""The docking procedure: from staging to a measured current, one step for each state.

A step does what its state is for and returns the event that ended it; ``states.next_state`` says what follows. Every
retry changes something: (1) as planned, (2) a scan from another viewpoint merged with the first, (3) a fresh scan and a
bounded, force-guarded search. Then the arm retreats, or holds, and a person is asked for, with the evidence kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.commands import Announce, MoveJoints, MoveLinear, StopMotion
from controller.durable import forget_insertion, remember_insertion
from controller.faults import Fault, FaultCode, MissionFault
from controller.insertion import Verdict, insert
from controller.planning import DockPlan, PlanRefusedError, plan_dock
from controller.self_check import before_port
from controller.states import Event
from controller.surroundings import boxes_around
from controller.task import Goal, Task
from drivers.base import ChargerRequest, ChargerState, ChargerStatus, DockPose, PlugLock, Proximity, RequestResult
from perception.estimate import PortEstimate

PLUG_SENSED = (Proximity.INSERTED, Proximity.LATCHED)
POSE_TOLERANCE_M = 0.001
POWER_S = 30.0
"""From the request to a measured current: handshake, pre-charge, ramp."""


# --- before contact -------------------------------------------------------------------------------------------------


def stage(task: Task) -> Event:
    """Reserve the charger, go to where the next sweep starts."""
    if not task.now.reserved:
        _reserve(task)
    _back_out(task)
    task.cell.arm.set_obstacles(())  # what was seen last time may have moved with the car, or been closed
    motion, patience_s = task.config.motion, task.config.deadlines.staging_s
    start = task.looking.viewpoint().T_base_tcp_start
    speed, acceleration = np.deg2rad([motion.joint_speed_deg_s, motion.joint_acceleration_deg_s2])
    task.cell.travel(MoveJoints(start, float(speed), float(acceleration)), patience_s)
    task.cell.settle(0.001, patience_s)
    return Event.AT_STAGING


def _reserve(task: Task) -> None:
    """The charger is ours. One that did not hear the end of the session before is released from that first."""
    if task.cell.charger_says(lambda s: s.state in (ChargerState.READY, ChargerState.FINISHED)):
        task.must(ChargerRequest.RELEASE)
    task.must(ChargerRequest.RESERVE)
    task.must(ChargerRequest.UNLOCK_DOCK)
    task.now.reserved = True


def scan(task: Task) -> Event:
    """Laser on, one straight sweep, laser off; profiles and arm poses joined by time."""
    task.looking.sweep(task.watcher.progress)
    return Event.SCAN_COMPLETE


def locate(task: Task) -> Event:
    """Perception at rest; what it refuses is looked at from the next viewpoint."""
    looking, now = task.looking, task.now
    estimate = looking.locate()
    if looking.cloud is not None:
        task.watcher.scan(looking.cloud)
    if estimate is not None:
        task.watcher.estimate(estimate)
        now.estimate = estimate
        if estimate.accepted:
            now.setback = None
            return Event.LOCATED
    if looking.may_look_again(now.attempt):
        return Event.NEXT_VIEWPOINT
    if now.setback is None:  # otherwise the failed insertion before is what a person has to know
        reasons = "; ".join(estimate.reasons) if estimate is not None else looking.problem
        now.setback = Fault(FaultCode.PORT_NOT_FOUND, reasons)
    return Event.NOT_LOCATED


def approach(task: Task) -> Event:
    """Plan, announce, move to pre-contact; axis and depth are on disk before the arm nears the vehicle."""
    cell, motion, estimate = task.cell, task.config.motion, task.now.estimate
    assert estimate is not None
    cell.arm.set_obstacles(boxes_around(task.looking.cloud, estimate))
    try:
        plan = plan_dock(estimate, task.T_port_tcp_mated, motion, cell.reach)
    except PlanRefusedError as error:
        raise MissionFault(FaultCode.PLAN_REFUSED, error.cause) from error
    task.plan, cell.T_base_port = plan, plan.T_base_port
    _announce(task, plan, estimate)
    patience_s, acceleration = task.config.deadlines.approaching_s, motion.acceleration_mm_s2 / 1000.0
    cell.travel(MoveLinear(plan.retreat, motion.linear_speed_mm_s / 1000.0, acceleration), patience_s)
    remember_insertion(task.state_folder, plan)
    cell.travel(MoveLinear(plan.pre_contact, motion.approach_speed_mm_s / 1000.0, acceleration), patience_s)
    return Event.AT_PRE_CONTACT


def _announce(task: Task, plan: DockPlan, estimate: PortEstimate) -> None:
    """Tell the charger where the plug is going."""
    cell = task.cell
    cell.supervisor.facts.clear_of_vehicle = False
    quality = (estimate.rms_residual_m, estimate.inlier_ratio, POSE_TOLERANCE_M, cell.wall.now_s())
    cell.do(Announce(DockPose(plan.T_base_port, *quality)))


def _back_out(task: Task) -> None:
    """After a pause or a fault the arm may stand close before the vehicle: out on the axis first, then elsewhere."""
    plan, motion = task.plan, task.config.motion
    if plan is None:
        return
    if before_port(plan, task.cell.arm_state(), motion):
        acceleration = motion.acceleration_mm_s2 / 1000.0
        out = MoveLinear(plan.retreat, motion.approach_speed_mm_s / 1000.0, acceleration)
        task.cell.travel(out, task.config.deadlines.staging_s)
    forget_insertion(task.state_folder)
    task.plan, task.cell.T_base_port = None, None
    task.cell.supervisor.facts.clear_of_vehicle = True


# --- contact --------------------------------------------------------------------------------------------------------


def push_in(task: Task) -> Event:
    """Force-guarded, on the port's axis; the last rung may search."""
    patience_s = task.config.deadlines.inserting_s
    assert task.plan is not None, "APPROACHING made it"
    result = insert(task.cell, task.plan, task.config.insertion_here, search=task.last_attempt, timeout_s=patience_s)
    task.now.insertion = result
    task.watcher.insertion(result)
    if result.verdict is Verdict.SEATED:
        return Event.SEATED
    code = FaultCode.FORCE_LIMIT if result.verdict is Verdict.OVERLOAD else FaultCode.INSERTION_BLOCKED
    return _failed(task, Fault(code, result.detail), Event.NOT_INSERTED)


def verify(task: Task) -> Event:
    """Hold the seating force until the charger senses the plug and has locked it: only then it is mated."""
    cell, patience_s = task.cell, 0.4 * task.config.deadlines.verifying_s
    sensed = cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.proximity in PLUG_SENSED), patience_s)
    if sensed:
        cell.ask(ChargerRequest.LOCK_PLUG, patience_s)
        locked = cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.lock is PlugLock.LOCKED), patience_s)
        if locked:
            cell.supervisor.facts.mated = True
            state = cell.arm_state()
            task.now.T_base_tcp_mated, task.now.plan = None if state is None else state.T_base_tcp, task.plan
            return Event.MATED
        cell.ask(ChargerRequest.UNLOCK_PLUG, patience_s)
    cell.do(StopMotion())
    why = "plug not locked" if sensed else "the charger senses no plug"
    return _failed(task, Fault(FaultCode.NOT_MATED, why), Event.NOT_MATED)


def _failed(task: Task, setback: Fault, event: Event) -> Event:
    """The next rung of the ladder; after the last one the arm retreats, or holds until a person comes."""
    task.now.setback = setback
    if task.last_attempt and task.config.mission.on_final_failure == "hold":
        raise MissionFault(setback.code, setback.detail)
    return event


# --- charging -------------------------------------------------------------------------------------------------------


def charge(task: Task) -> Event | None:
    """Power on; charging is a measured current, never a command's echo.

    None: docked, and the job is done or the process is to end.
    """
    cell, mission, desk = task.cell, task.config.mission, task.desk
    cell.do(StopMotion())
    task.must(ChargerRequest.ENABLE_POWER)
    if not _current_comes(task) and not desk.leaving:
        task.now.setback = Fault(FaultCode.NOT_CHARGING, f"no {mission.min_charge_current_a:g} A after {POWER_S:g} s")
        return Event.CHARGE_COMPLETE
    ended = cell.supervisor.wait(
        lambda: desk.leaving or cell.charger_says(lambda s: not _flows(task, s)), mission.charge_s
    )
    if ended and cell.charger_says(lambda s: s.state is ChargerState.STOPPING):  # on its way to Finished, or to a fault
        cell.supervisor.wait(
            lambda: desk.leaving or not cell.charger_says(lambda s: s.state is ChargerState.STOPPING),
            task.config.deadlines.releasing_s,
        )
    if desk.leaving:
        return None
    if ended and not cell.charger_says(_rests):
        task.now.setback = Fault(FaultCode.NOT_CHARGING, "the current broke off")
        return Event.CHARGE_COMPLETE
    cell.compare_with_car(mission.min_charge_current_a)
    if task.now.goal is not Goal.DOCK:
        return Event.CHARGE_COMPLETE
    task.charging_seen = True
    return None


@dataclass(frozen=True, slots=True)
class ChargeEnded:
    """A charge that is over without anybody having asked."""

    setback: Fault | None = None
    """Why, when it is not because the vehicle is full."""


def watch_charge(task: Task) -> ChargeEnded | None:
    """Docked, at rest: until a job comes, the process ends, the vehicle is full, or the charge breaks off.

    A charge that was found at the start is only observed. One that breaks off is begun again once; then the plug is
    taken out and a person asked for. Nothing is ever chased. None: a job has come, or the process is to end.
    """
    cell, desk = task.cell, task.desk

    def asked() -> bool:
        return desk.leaving or desk.pending is not None

    def over() -> bool:
        return task.charging_seen and cell.charger_says(lambda s: not s.contactor_closed and s.state in _NOT_LIVE)

    cell.supervisor.wait(lambda: asked() or over())
    if asked():
        return None
    if cell.charger_says(lambda s: s.state is ChargerState.FINISHED):
        task.charging_seen = False
        return ChargeEnded() if task.config.mission.when_full == "undock" else None
    if cell.ask(ChargerRequest.ENABLE_POWER, POWER_S) is RequestResult.DONE and _current_comes(task):
        return None
    return ChargeEnded(Fault(FaultCode.NOT_CHARGING, "the current broke off and did not come back"))


_NOT_LIVE = (ChargerState.FINISHED, ChargerState.READY, ChargerState.IDLE, ChargerState.RESERVED)
"""In all other states the charger is busy with the charge, holds back, or says that something is wrong."""


def _current_comes(task: Task) -> bool:
    cell = task.cell
    return cell.supervisor.wait(lambda: task.desk.leaving or cell.charger_says(lambda s: _flows(task, s)), POWER_S)


def _flows(task: Task, status: ChargerStatus) -> bool:
    return status.contactor_closed and status.current_a >= task.config.mission.min_charge_current_a


def _rests(status: ChargerStatus) -> bool:
    """No current, and rightly so: the vehicle is full, or the charger holds back for a while."""
    return status.state in (ChargerState.FINISHED, ChargerState.PAUSED)
