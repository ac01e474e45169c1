"""SELF_CHECK: links fresh, and before anything else the plug: what is inserted is never moved without being asked for.

A plug counts as inserted when the proximity contact says so, or when the arm still stands on the axis of an insertion
that was under way when an earlier process ended: the contact senses only a plug that is home.
"""

from __future__ import annotations

from controller.commands import ZeroForce
from controller.config import MotionConfig
from controller.durable import forget_insertion, recall_insertion
from controller.faults import FaultCode, MissionFault
from controller.insertion import CLEAR_M
from controller.planning import DockPlan, plan_on_axis
from controller.states import Event
from controller.task import Goal, Task
from drivers.base import (
    ArmState,
    ChargerRequest,
    ChargerState,
    ChargerStatus,
    Proximity,
    RequestResult,
    RobotMode,
)
from perception.geometry import Pose

LOOKS = 3
"""So many ticks have judged the interlocks before anything else is done."""
BESIDE_AXIS_M = 0.020
"""An arm this far beside a stored axis has been driven away from it by a person: the plug is not in the port."""
OFF_AXIS_M = 0.005
"""Nearer than this to the stored axis, the plug may be pulled along it."""


def check_self(task: Task) -> Event:
    """What the procedure may begin with. Raises MissionFault with what is in the way."""
    cell, patience_s = task.cell, task.config.deadlines.self_check_s / 3.0
    cell.supervisor.wait(lambda: cell.arm_state() is not None and cell.charger_status() is not None, patience_s)
    cell.supervisor.wait_ticks(LOOKS)
    task.plan = stored_plan(task)
    cell.T_base_port = None if task.plan is None else task.plan.T_base_port
    if plug_may_be_in(cell.arm_state(), cell.charger_status(), task.plan):
        return _with_plug(task, patience_s)
    cell.supervisor.facts.mated = False
    _await_arm(task, patience_s)
    _await_charger(task, patience_s)
    cell.settle(0.002, patience_s)
    cell.do(ZeroForce())
    if task.plan is not None and not before_port(task.plan, cell.arm_state(), task.config.motion):
        forget_insertion(task.state_folder)
        task.plan, cell.T_base_port = None, None
    return Event.CHECKS_PASSED


def stored_plan(task: Task) -> DockPlan | None:
    """The docking that was under way when its axis was stored."""
    stored = recall_insertion(task.state_folder)
    if stored is None:
        return None
    return plan_on_axis(stored.T_base_port, stored.T_port_tcp_mated, task.config.motion)


def plug_may_be_in(arm: ArmState | None, charger: ChargerStatus | None, plan: DockPlan | None) -> bool:
    """Whether anything speaks for an inserted plug. What is not known speaks for it."""
    if charger is None or charger.proximity is not Proximity.ABSENT:
        return True
    if plan is None:
        return False
    return arm is None or (plan.lateral_m(arm.T_base_tcp) < BESIDE_AXIS_M and plan.depth_m(arm.T_base_tcp) > -CLEAR_M)


def before_port(plan: DockPlan, arm: ArmState | None, motion: MotionConfig) -> bool:
    """Whether the plug stands in front of the port, nearer than the retreat pose: the way out is along the axis."""
    if arm is None:
        return False
    height_m = -plan.depth_m(arm.T_base_tcp)
    return plan.lateral_m(arm.T_base_tcp) < 2.5 * BESIDE_AXIS_M and height_m < motion.retreat_mm / 1000.0 - 0.001


def stands_before_port(task: Task) -> bool:
    """Whether the arm was stopped on its way between retreat pose and port, and still stands there."""
    return task.plan is not None and before_port(task.plan, task.cell.arm_state(), task.config.motion)


def _with_plug(task: Task, patience_s: float) -> Event:
    """A plug is in: observe a charge, take it out if that was asked for, else say so and leave it."""
    cell = task.cell
    if cell.charger_says(lambda s: s.state is ChargerState.ESTOP):
        _await_charger(task, patience_s)
    status = cell.charger_status()
    charging = status is not None and status.contactor_closed
    cell.supervisor.facts.clear_of_vehicle = False
    cell.supervisor.facts.mated = status is not None and status.proximity is not Proximity.ABSENT
    if charging and cell.charger_says(lambda s: s.current_a >= task.config.mission.min_charge_current_a):
        return Event.CHARGING_FOUND
    if task.now.goal is not Goal.UNDOCK:
        raise MissionFault(FaultCode.PLUG_INSERTED_AT_START, _found(task, status))
    if task.plan is None:
        raise MissionFault(FaultCode.AXIS_UNKNOWN, "no insertion is stored")
    _await_arm(task, patience_s)
    arm = cell.arm_state()
    if arm is None or not on_axis(task.plan, arm.T_base_tcp):
        raise MissionFault(FaultCode.AXIS_UNKNOWN, "the arm does not stand on the stored insertion axis")
    _await_charger(task, patience_s)
    return Event.UNDOCK_REQUESTED


def on_axis(plan: DockPlan, T_base_tcp: Pose) -> bool:
    """Whether the TCP is where an insertion on the plan's axis can have left it."""
    depth_m = plan.depth_m(T_base_tcp)
    return plan.lateral_m(T_base_tcp) < OFF_AXIS_M and -CLEAR_M < depth_m < plan.mated_depth_m + OFF_AXIS_M


def _found(task: Task, status: ChargerStatus | None) -> str:
    if status is None or status.proximity is Proximity.ABSENT:
        return "the arm stands where an insertion was under way"
    fault = f", charger fault code {status.fault_code}" if status.state is ChargerState.FAULT else ""
    stored = "known" if task.plan is not None else "not known"
    return f"the proximity contact says {status.proximity.name}; the insertion axis is {stored}{fault}"


def _await_arm(task: Task, patience_s: float) -> None:
    cell = task.cell
    cell.supervisor.wait(lambda: _ready_arm(cell.arm_state()), patience_s)
    if not _ready_arm(cell.arm_state()):
        raise MissionFault(FaultCode.ARM_NOT_READY, "the arm is not powered and running")


def _await_charger(task: Task, patience_s: float) -> None:
    """The charger lets us move. What it latched when it lost the robot an operator's reset or undock ends; what its
    emergency stop left, nothing but a reset."""
    cell, goal, refusal = task.cell, task.now.goal, ""
    stopped = cell.charger_says(lambda s: s.state is ChargerState.ESTOP)
    asked_for = goal is Goal.RESET or (goal is Goal.UNDOCK and not stopped)
    if asked_for and cell.charger_says(lambda s: s.forbids_motion):
        answer = cell.ask(ChargerRequest.RESET_FAULT, patience_s)
        refusal = f"; it refused to be reset: {cell.charger.refusal()}" if answer is RequestResult.REJECTED else ""
    if (asked_for or not stopped) and cell.supervisor.wait(
        lambda: cell.charger_says(lambda s: not s.forbids_motion), patience_s
    ):
        return
    status = cell.charger_status()
    if status is not None and status.state is ChargerState.FAULT:
        raise MissionFault(FaultCode.CHARGER_FAULT, f"charger fault code {status.fault_code}{refusal}")
    if status is not None and status.state is ChargerState.ESTOP:
        raise MissionFault(
            FaultCode.EMERGENCY_STOP, f"released at the charger, which has not been reset since{refusal}"
        )
    raise MissionFault(FaultCode.CHARGER_FAULT, f"the charger inhibits motion although it gets our heartbeat{refusal}")


def _ready_arm(state: ArmState | None) -> bool:
    return state is not None and state.mode is RobotMode.RUNNING and state.program_running
