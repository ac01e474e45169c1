"""One docking mission: a step for each state, attempts, escalation. Reads like the docking procedure.

A step does what its state is for and returns the event that ended it; ``states.next_state`` says what follows. Every
retry changes something: (1) as planned, (2) a scan from another viewpoint merged with the first, (3) a fresh scan and a
bounded, force-guarded search. Then the arm retreats and a person is asked for, with the evidence kept.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from controller.cell import Cell
from controller.commands import Announce, AskCharger, Laser, MoveJoints, MoveLinear, StopMotion, ZeroForce
from controller.config import SiteConfig
from controller.durable import forget_insertion, remember_insertion
from controller.faults import Fault, FaultCode, MissionFault, Outcome
from controller.insertion import Insertion, Verdict, insert, withdraw
from controller.looking import Looking
from controller.planning import DockPlan, PlanRefusedError, plan_dock
from controller.states import Event, State, next_state
from controller.supervisor import PauseRequested, StopRequested
from drivers.base import (
    ArmState,
    ChargerRequest,
    ChargerState,
    DockPose,
    LinkLostError,
    PlugLock,
    Proximity,
    RequestResult,
    RobotMode,
)
from perception.errors import PortdockError
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud

log = logging.getLogger(__name__)

PLUG_SENSED = (Proximity.INSERTED, Proximity.LATCHED)


class Watcher(Protocol):
    """Who is told what happens: the recorder and the terminal."""

    def transition(self, source: str, event: str, target: str, time_s: float) -> None: ...
    def progress(self, label: str, fraction: float, detail: str) -> None: ...
    def scan(self, cloud: Cloud) -> None: ...
    def estimate(self, estimate: PortEstimate) -> None: ...
    def insertion(self, insertion: Insertion) -> None: ...


@dataclass(slots=True)
class Progress:
    """What a mission has come to so far."""

    begun: bool = False
    reserved: bool = False
    """The charger has been reserved and its dock unlocked."""
    attempt: int = 1
    estimate: PortEstimate | None = None
    insertion: Insertion | None = None
    setback: Fault | None = None
    """Why the present attempt failed."""
    outcome: Outcome | None = None
    stopping: bool = False


class Mission:
    """Dock, charge, release. One object a mission."""

    def __init__(
        self,
        cell: Cell,
        config: SiteConfig,
        T_port_tcp_mated: Pose,
        watcher: Watcher,
        state_folder: Path,
    ) -> None:
        self.cell = cell
        self.config = config
        self.state = State.OFFLINE
        self.now = Progress()
        self._T_port_tcp_mated = T_port_tcp_mated
        self._watcher = watcher
        self._state_folder = state_folder
        self.looking = Looking(cell, config)
        self._plan: DockPlan | None = None
        self._steps: dict[State, Callable[[], Event]] = {
            State.SELF_CHECK: self._self_check,
            State.READY: self._ready,
            State.STAGING: self._staging,
            State.SCANNING: self._scanning,
            State.LOCATING: self._locating,
            State.APPROACHING: self._approaching,
            State.INSERTING: self._inserting,
            State.VERIFYING: self._verifying,
            State.CHARGING: self._charging,
            State.RELEASING: self._releasing,
            State.RETREATING: self._retreating,
            State.HOLD: self._hold,
        }

    def run(self) -> Outcome:
        """From OFFLINE to an outcome; never raises for anything a device, the port or the operator does."""
        self._pass(Event.STARTED)
        while self.now.outcome is None:
            self._pass(self._event_of_step())
            if self.state is State.FAULT:
                self._make_safe()
        return self.now.outcome

    def _event_of_step(self) -> Event:
        try:
            return self._steps[self.state]()
        except StopRequested:
            self.now.stopping = True
            return self._freeze(Event.STOP)
        except PauseRequested as pause:
            log.warning("hold: %s", pause)
            return self._freeze(Event.PAUSED)
        except MissionFault as error:
            return self._fail(error.fault)
        except LinkLostError as error:
            return self._fail(self.cell.explained(FaultCode.ARM_LINK_LOST, error.cause).fault)
        except PortdockError as error:
            return self._fail(Fault(FaultCode.INTERNAL, f"{error.code}: {error.cause}"))
        except Exception as error:  # a defect must still end in FAULT with the arm stopped, not in a traceback
            log.exception("defect in %s", self.state.name)
            return self._fail(Fault(FaultCode.INTERNAL, f"{type(error).__name__}: {error}"))

    def _pass(self, event: Event) -> None:
        """One transition: told to supervisor, gate, recorder and terminal before the next step starts."""
        source, self.state = self.state, next_state(self.state, event)
        log.info("%s -> %s (%s)", source.name, self.state.name, event.value, extra={"state": self.state.name})
        self.cell.enter(self.state, self._longest_stay_s())
        self._watcher.transition(source.name, event.value, self.state.name, self.cell.clock.now_s())
        if self.state is State.READY and self.now.begun:
            self.now.outcome = self._verdict()

    def _verdict(self) -> Outcome:
        """Back in READY: what the mission came to."""
        if self.now.stopping:
            return Outcome("stopped")
        if self.now.setback is None:
            return Outcome("charged")
        refused = self.now.setback.code is FaultCode.PORT_NOT_FOUND
        return Outcome("refused" if refused else "intervention-needed", self.now.setback)

    def _longest_stay_s(self) -> float | None:
        return getattr(self.config.deadlines, f"{self.state.name.lower()}_s", None)

    def _fail(self, fault: Fault) -> Event:
        self.now.outcome = Outcome("fault", fault)
        return fault.event

    def _freeze(self, event: Event) -> Event:
        """Stop what moves and measures before the state changes."""
        self.cell.do(StopMotion())
        self.cell.do(Laser(on=False))
        return event

    # --- before contact

    def _self_check(self) -> Event:
        """Links fresh, arm ready; proximity before anything else."""
        cell, patience_s = self.cell, self.config.deadlines.self_check_s
        cell.supervisor.wait(lambda: cell.arm_state() is not None and cell.charger_status() is not None, patience_s)
        cell.supervisor.wait(lambda: _ready_arm(cell.arm_state()), patience_s / 3.0)
        if not _ready_arm(cell.arm_state()):
            raise MissionFault(FaultCode.ARM_NOT_READY, "the arm is not powered and running")
        permitted = cell.supervisor.wait(lambda: cell.charger_says(lambda s: not s.motion_inhibit), patience_s / 3.0)
        if not permitted:
            raise MissionFault(FaultCode.CHARGER_FAULT, "the charger inhibits motion although it gets our heartbeat")
        if not cell.charger_says(lambda s: s.proximity is Proximity.ABSENT):
            raise MissionFault(FaultCode.PLUG_INSERTED_AT_START, "the proximity contact reports a plug")
        cell.settle(0.002, patience_s)
        cell.do(ZeroForce())
        return Event.CHECKS_PASSED

    def _ready(self) -> Event:
        """Begin the mission."""
        self.now.begun = True
        return Event.DOCK_REQUESTED

    def _staging(self) -> Event:
        """Reserve the charger, go to where the next sweep starts."""
        if not self.now.reserved:
            self._must(ChargerRequest.RESERVE)
            self._must(ChargerRequest.UNLOCK_DOCK)
            self.now.reserved = True
        motion, patience_s = self.config.motion, self.config.deadlines.staging_s
        start = self.looking.viewpoint().T_base_tcp_start
        speed, acceleration = np.deg2rad([motion.joint_speed_deg_s, motion.joint_acceleration_deg_s2])
        self.cell.travel(MoveJoints(start, float(speed), float(acceleration)), patience_s)
        self.cell.settle(0.001, patience_s)
        return Event.AT_STAGING

    def _scanning(self) -> Event:
        """Laser on, one straight sweep, laser off; profiles and arm poses joined by time."""
        self.looking.sweep(self._watcher.progress)
        return Event.SCAN_COMPLETE

    def _locating(self) -> Event:
        """Perception at rest; what it refuses is looked at from the next viewpoint."""
        estimate = self.looking.locate()
        if self.looking.cloud is not None:
            self._watcher.scan(self.looking.cloud)
        if estimate is not None:
            self._watcher.estimate(estimate)
            self.now.estimate = estimate
            if estimate.accepted:
                self.now.setback = None
                return Event.LOCATED
        if self.looking.may_look_again(self.now.attempt):
            return Event.NEXT_VIEWPOINT
        reasons = "; ".join(estimate.reasons) if estimate is not None else self.looking.problem
        if self.now.setback is None:  # otherwise the failed insertion before is what a person has to know
            self.now.setback = Fault(FaultCode.PORT_NOT_FOUND, reasons)
        return Event.NOT_LOCATED

    def _approaching(self) -> Event:
        """Plan, announce, move to pre-contact; axis and depth are on disk before anything touches."""
        cell, motion, estimate = self.cell, self.config.motion, self.now.estimate
        assert estimate is not None
        try:
            plan = plan_dock(estimate, self._T_port_tcp_mated, motion, cell.reach)
        except PlanRefusedError as error:
            raise MissionFault(FaultCode.PLAN_REFUSED, error.cause) from error
        self._plan = plan
        cell.T_base_port = plan.T_base_port
        cell.supervisor.facts.clear_of_vehicle = False
        cell.do(
            Announce(
                DockPose(plan.T_base_port, estimate.rms_residual_m, estimate.inlier_ratio, 0.001, cell.wall.now_s())
            )
        )
        patience_s, acceleration = self.config.deadlines.approaching_s, motion.acceleration_mm_s2 / 1000.0
        cell.travel(MoveLinear(plan.retreat, motion.linear_speed_mm_s / 1000.0, acceleration), patience_s)
        cell.travel(MoveLinear(plan.pre_contact, motion.approach_speed_mm_s / 1000.0, acceleration), patience_s)
        remember_insertion(self._state_folder, plan)
        return Event.AT_PRE_CONTACT

    # --- contact

    def _inserting(self) -> Event:
        """Force-guarded, on the port's axis; the last rung may search."""
        search = self.now.attempt >= self.config.mission.max_attempts
        patience_s = self.config.deadlines.inserting_s
        result = insert(self.cell, self._planned(), self.config.insertion, search=search, timeout_s=patience_s)
        self.now.insertion = result
        self._watcher.insertion(result)
        if result.verdict is Verdict.SEATED:
            return Event.SEATED
        code = FaultCode.FORCE_LIMIT if result.verdict is Verdict.OVERLOAD else FaultCode.INSERTION_BLOCKED
        self.now.setback = Fault(code, result.detail)
        return Event.NOT_INSERTED

    def _verifying(self) -> Event:
        """Hold the seating force until the charger senses the plug and has locked it: only then it is mated."""
        cell, patience_s = self.cell, 0.4 * self.config.deadlines.verifying_s
        sensed = cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.proximity in PLUG_SENSED), patience_s)
        if sensed:
            cell.ask(ChargerRequest.LOCK_PLUG, patience_s)
            locked = cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.lock is PlugLock.LOCKED), patience_s)
            if locked:
                cell.supervisor.facts.mated = True
                return Event.MATED
            cell.ask(ChargerRequest.UNLOCK_PLUG, patience_s)
        self.now.setback = Fault(FaultCode.NOT_MATED, "plug not locked" if sensed else "the charger senses no plug")
        cell.do(StopMotion())
        return Event.NOT_MATED

    def _charging(self) -> Event:
        """Power on; charging is a measured current, never a command's echo."""
        cell, mission = self.cell, self.config.mission
        cell.do(StopMotion())
        self._must(ChargerRequest.ENABLE_POWER)
        wanted_a = mission.min_charge_current_a
        flowing = cell.supervisor.wait(
            lambda: cell.charger_says(lambda s: s.contactor_closed and s.current_a >= wanted_a), 30.0
        )
        if not flowing:
            self.now.setback = Fault(FaultCode.NOT_CHARGING, f"no {wanted_a:g} A after 30 s")
            return Event.CHARGE_COMPLETE
        ended = cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.current_a < wanted_a), mission.charge_s)
        if ended and cell.charger_says(lambda s: s.state is not ChargerState.FINISHED):
            self.now.setback = Fault(FaultCode.NOT_CHARGING, "the current broke off")
        return Event.CHARGE_COMPLETE

    def _releasing(self) -> Event:
        """Power off, current gone, contactor open, lock open: each seen, in this order."""
        cell, patience_s = self.cell, self.config.deadlines.releasing_s / 3.0
        cell.do(AskCharger(ChargerRequest.STOP_POWER))
        dead = cell.supervisor.wait(
            lambda: cell.charger_says(lambda s: not s.contactor_closed and abs(s.current_a) < 1.0), patience_s
        )
        if not dead:
            raise MissionFault(FaultCode.RELEASE_FAILED, "current or contactor did not go off")
        cell.ask(ChargerRequest.UNLOCK_PLUG, patience_s)
        if not cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.lock is PlugLock.UNLOCKED), patience_s):
            raise MissionFault(FaultCode.RELEASE_FAILED, "the lock did not open")
        return Event.RELEASED

    def _retreating(self) -> Event:
        """Out along the axis that was inserted on, then clear of the vehicle."""
        cell, plan, motion = self.cell, self._planned(), self.config.motion
        patience_s = self.config.deadlines.retreating_s
        cell.do(StopMotion())
        withdraw(cell, plan, self.config.insertion, patience_s)
        cell.supervisor.wait(lambda: cell.charger_says(lambda s: s.proximity is Proximity.ABSENT), patience_s)
        speed, acceleration = self.config.insertion.withdraw_speed_mm_s / 1000.0, motion.acceleration_mm_s2 / 1000.0
        cell.travel(MoveLinear(plan.retreat, speed, acceleration), patience_s)
        forget_insertion(self._state_folder)
        cell.supervisor.facts.mated = False
        cell.supervisor.facts.clear_of_vehicle = True
        cell.do(Announce(None))
        return self._after_retreat()

    def _after_retreat(self) -> Event:
        """The next rung of the ladder, or the end."""
        retry = self.now.setback is not None and self.now.attempt < self.config.mission.max_attempts
        if self.now.setback is not None and self.now.setback.code is FaultCode.NOT_CHARGING:
            retry = False
        if retry and not self.now.stopping:
            self.now.attempt += 1
            if self.now.attempt == self.config.mission.max_attempts:
                self.looking.forget_scans()
            return Event.RETREATED_TO_RETRY
        self.cell.do(AskCharger(ChargerRequest.RELEASE))
        return Event.RETREATED

    def _hold(self) -> Event:
        """Wait until the reason for the pause is gone, then start over at staging."""
        gone = self.cell.supervisor.wait(lambda: self.cell.supervisor.pause is None, self.config.deadlines.hold_s)
        if not gone:
            raise MissionFault(FaultCode.DEADLINE, "the pause lasted too long")
        self.cell.recover_arm()
        return Event.RESUMED

    def _make_safe(self) -> None:
        """On entry to FAULT: nothing moves, no laser, no power wanted. Each is tried, whatever the others do."""
        for command in (StopMotion(), Laser(on=False), Announce(None), AskCharger(ChargerRequest.ABORT)):
            try:
                self.cell.do(command)
            except PortdockError as error:
                log.error("making safe: %s", error)

    # --- helpers of the steps

    def _must(self, request: ChargerRequest) -> None:
        result = self.cell.ask(request, 5.0)
        if result is not RequestResult.DONE:
            raise MissionFault(FaultCode.CHARGER_REJECTED, f"{request.name}: {result.name}")

    def _planned(self) -> DockPlan:
        assert self._plan is not None, "a state from APPROACHING on has a plan"
        return self._plan


def _ready_arm(state: ArmState | None) -> bool:
    return state is not None and state.mode is RobotMode.RUNNING and state.program_running
