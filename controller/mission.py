"""The state machine at work: which step belongs to which state, what ends a job, what a fault does.

The steps themselves are in ``self_check``, ``docking`` and ``undocking``, each in the order of the procedure. A mission
that is run once (dry run, teaching, a campaign's cell) has one job; a daemon's or a soak's serves one job after the
other and rests in READY, in CHARGING with a docked plug, or in FAULT until an operator's reset.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from controller.back_off import back_off
from controller.cell import Cell
from controller.commands import Announce, AskCharger
from controller.config import SiteConfig
from controller.docking import approach, charge, locate, push_in, scan, stage, verify, watch_charge
from controller.faults import Fault, FaultCode, MissionFault, Outcome
from controller.looking import Looking
from controller.self_check import check_self, stands_before_port
from controller.states import RESTING, Event, State, next_state
from controller.supervisor import PauseRequested, StopRequested
from controller.task import Desk, Goal, Progress, SingleJob, Task, Watcher
from controller.undocking import release, retreat
from controller.waiting import NO_AXIS, hold, leave_docked
from drivers.base import ChargerRequest, LinkLostError, Proximity
from perception.errors import PortdockError
from perception.geometry import Pose

log = logging.getLogger(__name__)

STEPS: dict[State, Callable[[Task], Event | None]] = {
    State.SELF_CHECK: check_self,
    State.STAGING: stage,
    State.SCANNING: scan,
    State.LOCATING: locate,
    State.APPROACHING: approach,
    State.INSERTING: push_in,
    State.VERIFYING: verify,
    State.RELEASING: release,
    State.RETREATING: retreat,
    State.HOLD: hold,
}
"""The procedure. READY, CHARGING and FAULT, where a mission rests, are below."""


class Mission:
    """One robot's state machine."""

    def __init__(
        self,
        cell: Cell,
        config: SiteConfig,
        T_port_tcp_mated: Pose,
        watcher: Watcher,
        state_folder: Path,
        looking: Callable[[], Looking] | None = None,
    ) -> None:
        """``looking``: makes what sweeps and locates for one job."""
        self.state = State.OFFLINE
        self.fault: Fault | None = None
        """The latched fault while in FAULT."""
        self._make_looking = looking or (lambda: Looking(cell, config))
        self.task = Task(cell, config, T_port_tcp_mated, watcher, state_folder, SingleJob(None), self._make_looking())
        self._steps = STEPS | {
            State.READY: self._ready,
            State.CHARGING: self._charging,
            State.FAULT: self._fault,
        }

    @property
    def now(self) -> Progress:
        """How far the present job, or the last one, has come."""
        return self.task.now

    def run(self, goal: Goal = Goal.CYCLE) -> Outcome:
        """One job from OFFLINE to its outcome; never raises for anything a device, the port or the operator does."""
        self.task.desk = SingleJob(goal)
        self.task.now = Progress(goal)
        self._pass(Event.STARTED)
        while self.now.outcome is None:
            self._step()
        return self.now.outcome

    def go_on(self, state: State, goal: Goal, first: Event) -> Outcome:
        """One job from a state of rest to its outcome: a replay of a daemon's recording, with its first transition."""
        self.state, asked = state, first not in (Event.STOP, Event.CHARGE_COMPLETE)
        self.task.desk = SingleJob(goal if asked else None)
        self.task.cell.enter(state, None)
        if first is Event.CHARGE_COMPLETE:  # what ended the charge, and how well, came before the recording
            self._begin(goal)
            self._pass(first)
        while self.now.outcome is None:
            self._step()
        return self.now.outcome

    def serve(self, desk: Desk) -> None:
        """One job after the other until the desk says that the process is leaving; never raises, as above."""
        self.task.desk = desk
        self._pass(Event.STARTED)
        while self.state is not State.OFFLINE:
            self._step()

    # --- one step -----------------------------------------------------------------------------------------------------

    def _step(self) -> None:
        """Do what the state is for; then the transition, if the state is over."""
        event = self._event_of_step()
        if event is not None:
            self._pass(event)

    def _event_of_step(self) -> Event | None:
        try:
            return self._event_or_interruption()
        except MissionFault as error:
            return self._latch(error.fault)
        except PortdockError as error:
            return self._latch(Fault(FaultCode.INTERNAL, f"{error.code}: {error.cause}"))
        except Exception as error:  # a defect must still end in FAULT with the arm stopped, not in a traceback
            log.exception("defect in %s", self.state.name)
            return self._latch(Fault(FaultCode.INTERNAL, f"{type(error).__name__}: {error}"))

    def _event_or_interruption(self) -> Event | None:
        try:
            return self._explained_step()
        except StopRequested:
            if self.state is State.CHARGING and self.task.desk.leaving:  # which switches off, and moves nothing
                self.task.cell.supervisor.clear_stop()
                return None
            if not self.now.going_on:  # docked, and no job: the stop is one
                if self.task.plan is None:
                    self.task.cell.supervisor.clear_stop()
                    self._answer(Outcome.of(NO_AXIS))
                    return None
                self._begin(Goal.UNDOCK)
            self.task.cell.supervisor.clear_stop()  # it belongs to this job
            self.now.stopping = True
            return self._freeze(Event.STOP)
        except PauseRequested as pause:
            log.warning("hold: %s", pause)
            return self._freeze(Event.PAUSED)

    def _explained_step(self) -> Event | None:
        try:
            return self._steps[self.state](self.task)
        except LinkLostError as error:
            raise self.task.cell.explained(FaultCode.ARM_LINK_LOST, error.cause) from error

    def _pass(self, event: Event) -> None:
        """One transition: told to supervisor, gate, recorder and terminal before the next step starts."""
        source, self.state = self.state, next_state(self.state, event)
        log.info("%s -> %s (%s)", source.name, self.state.name, event.value, extra={"state": self.state.name})
        self.task.cell.enter(self.state, self._longest_stay_s())
        self.task.watcher.transition(source.name, event.value, self.state.name, self.task.cell.clock.now_s())
        if self.state is State.FAULT and self.fault is not None:
            self.task.cell.make_safe()
            self.task.cell.supervisor.forget_requests()  # they are obeyed: what is asked for from now on counts
            self._conclude(Outcome.of(self.fault))
        elif self.state is State.READY and self.now.goal is not None and self.now.under_way:
            self._give_back()
            self._conclude(self.now.result())
        elif self.state is State.READY and self.task.desk.pending is None:  # a stop until then stops no later job
            self.task.cell.supervisor.clear_stop()

    def _longest_stay_s(self) -> float | None:
        at_rest = self.state in RESTING or (self.state is State.CHARGING and not self.now.going_on)
        return None if at_rest else float(getattr(self.task.config.deadlines, f"{self.state.name.lower()}_s"))

    def _latch(self, fault: Fault) -> Event:
        if fault.code is FaultCode.CHARGER_LINK_LOST and self.state is State.APPROACHING:
            back_off(self.task)
        self.fault = fault
        return fault.event

    def _freeze(self, event: Event) -> Event:
        """Stop what moves and measures before the state changes."""
        self.task.cell.freeze(scanning=self.state is State.SCANNING)
        return event

    # --- jobs ---------------------------------------------------------------------------------------------------------

    def _begin(self, goal: Goal) -> None:
        """A job leaves the state of rest."""
        task = self.task
        task.now = Progress(goal, under_way=True)
        if goal in (Goal.DOCK, Goal.CYCLE):
            task.looking = self._make_looking()
        task.watcher.began(goal)

    def _conclude(self, outcome: Outcome) -> None:
        """The job, if there is one, is over."""
        log.info("outcome: %s%s", outcome.kind, "" if outcome.fault is None else f" ({outcome.fault})")
        self.now.outcome = outcome
        if self.task.desk.pending is None:  # else a stop may be meant for the job that waits
            self.task.cell.supervisor.clear_stop()
        if self.state is State.CHARGING:  # the job is over, the rest has no deadline
            self.task.cell.enter(self.state, None)
        try:
            self.task.watcher.ended(outcome, self.now)
        except Exception:  # evidence costs neither the charge nor the answer
            log.exception("the evidence of this mission is not complete")
        self.task.desk.answered(outcome)

    def _give_back(self) -> None:
        """The charger is no longer reserved. It may refuse: the robot is out of the way in any case."""
        if self.now.goal not in (Goal.DOCK, Goal.CYCLE, Goal.UNDOCK):
            return
        announced = () if self.task.plan is None else (Announce(None),)  # not retreated
        for command in (*announced, AskCharger(ChargerRequest.RELEASE)):
            try:
                self.task.cell.do(command)
            except PortdockError as error:
                log.warning("%s", error)

    # --- where a mission rests ----------------------------------------------------------------------------------------

    def _wait_for_work(self) -> Goal | None:
        """The next job; None when the process is to end. Raises MissionFault on a trip."""
        supervisor, desk = self.task.cell.supervisor, self.task.desk
        supervisor.wait(lambda: desk.leaving or desk.pending is not None)
        return None if desk.leaving else desk.take()

    def _ready(self, task: Task) -> Event | None:
        """Heartbeats only, until a job begins; one that is already done is answered at once."""
        goal = self._wait_for_work()
        if goal is None:
            return Event.SHUT_DOWN
        if goal is Goal.UNDOCK and stands_before_port(task):
            self._begin(goal)
            return Event.UNDOCK_REQUESTED
        if goal in (Goal.UNDOCK, Goal.RESET):
            self.task.now = Progress(goal)
            self._answer(Outcome("already-undocked" if goal is Goal.UNDOCK else "ready"))
            return None
        self._begin(goal)
        if not task.cell.charger_says(lambda s: s.proximity is Proximity.ABSENT):
            raise MissionFault(FaultCode.PLUG_INSERTED_AT_START, "the proximity contact reports a plug")
        try:
            task.cell.restore_scanner()
        except PortdockError as error:
            raise MissionFault(FaultCode.SCANNER_LINK_LOST, error.cause) from error
        return Event.DOCK_REQUESTED

    def _charging(self, task: Task) -> Event | None:
        """Begin the charge, or, docked already, watch it until something is asked for."""
        if self.now.going_on:
            return self._charge_for_job(task)
        if (ended := watch_charge(task)) is not None:
            self._begin(Goal.UNDOCK)
            self.now.setback = ended.setback
            return Event.CHARGE_COMPLETE
        if task.desk.leaving:
            return leave_docked(task)
        return None if task.desk.pending is None else self._asked_while_docked(task.desk.take())

    def _charge_for_job(self, task: Task) -> Event | None:
        """A job that came here through VERIFYING begins the charge; one that found it going on is done, or goes on."""
        if self.now.goal is Goal.UNDOCK and task.plan is not None:
            return Event.UNDOCK_REQUESTED
        event = charge(task) if self.now.goal in (Goal.DOCK, Goal.CYCLE) else None
        if event is None:
            self._conclude(Outcome("stopped" if task.desk.leaving else "charging"))
        return event

    def _asked_while_docked(self, goal: Goal) -> Event | None:
        if goal is not Goal.UNDOCK:
            self._answer(Outcome("charging" if goal is Goal.RESET else "already-docked"))
            return None
        if self.task.plan is None:
            self._answer(Outcome.of(NO_AXIS))
            return None
        self._begin(goal)
        return Event.UNDOCK_REQUESTED

    def _fault(self, task: Task) -> Event | None:
        """Latched: nothing but an operator's reset, or the end of the process, leads out."""
        desk = task.desk
        task.cell.supervisor.idle(lambda: desk.leaving or desk.pending is not None)
        if desk.leaving:
            return Event.SHUT_DOWN
        goal, fault = desk.take(), self.fault or Fault(FaultCode.INTERNAL)
        asked_for = goal is Goal.UNDOCK and fault.code is FaultCode.PLUG_INSERTED_AT_START
        if goal is not Goal.RESET and not asked_for:
            self._answer(Outcome.of(fault))
            return None
        try:
            task.cell.restore_links()
        except PortdockError as error:
            self._answer(Outcome.of(Fault(FaultCode.RESET_REFUSED, f"{error.cause}. {error.remedy}")))
            return None
        self.fault, task.charging_seen = None, False
        task.cell.supervisor.reset()
        self._begin(goal)
        return Event.RESET

    def _answer(self, outcome: Outcome) -> None:
        """A job that is over before it begins."""
        log.info("answered at once: %s", outcome.kind)
        self.now.outcome = outcome
        self.task.desk.answered(outcome)
