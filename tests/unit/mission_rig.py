"""A cell of in-process stand-ins for mission tests: no wires, no mocks, quick; faults are switched on at any state.

The stand-ins obey ``drivers/base.py`` and record what they are asked. Mission, gate, supervisor and insertion are the
real ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from controller.cell import Cell
from controller.config import SiteConfig, load_config
from controller.faults import Outcome
from controller.insertion import Insertion
from controller.mission import Mission
from controller.pace import PacedClock
from controller.planning import FACING
from controller.situation import Limits
from controller.sources import Sources
from controller.supervisor import Supervisor
from controller.task import Goal, Progress
from drivers.base import (
    ArmState,
    Box,
    CanFrame,
    ChargerRequest,
    ChargerState,
    ChargerStatus,
    Compliance,
    DockPose,
    Heartbeat,
    LinkHealth,
    LinkLostError,
    MonotonicClock,
    MotionProgress,
    Pilot,
    PlugLock,
    Proximity,
    RequestResult,
    RobotMode,
    SafetyMode,
)
from perception.estimate import PortEstimate, Prior
from perception.geometry import Array, Pose
from perception.scan import Cloud, Profile

PACE = 20.0
MATED_DEPTH_M = 0.035
CLOCK = MonotonicClock()


class StandInArm:
    """Moves at once where it is sent; in force mode it slides in until something stops it."""

    def __init__(self, T_base_port: Pose) -> None:
        self.T_base_port = T_base_port
        self.pose = T_base_port @ Pose(FACING, np.array([0.0, 0.0, 0.3]))
        self.stop_depth_m = MATED_DEPTH_M
        self.lost = False
        self.safety = SafetyMode.NORMAL
        self.mode = RobotMode.RUNNING
        self.speed_scaling = 1.0
        self.moves: list[str] = []
        self.kicks = 0
        self.motion_fails = False
        self.recoveries = 0
        self.stuck = False
        self.obstacles: tuple[Box, ...] = ()
        self._velocity = np.zeros(3)
        self._push_n = 0.0
        self._last_s = CLOCK.now_s()

    @property
    def depth_m(self) -> float:
        return -float(self.T_base_port.inverse().apply(self.pose.translation)[2])

    def open(self) -> None: ...
    def close(self) -> None: ...

    def state(self) -> ArmState:
        if self.lost:
            raise LinkLostError("the arm is silent")
        self._advance()
        resistance = self._push_n if self._push_n and abs(self.depth_m - self.stop_depth_m) < 1e-6 else 0.0
        force = self.T_base_port.rotate(np.array([0.0, 0.0, resistance]))
        now_s = CLOCK.now_s()
        return ArmState(
            time_s=now_s,
            device_time_s=now_s * PACE,
            T_base_tcp=self.pose,
            T_flange_tcp=Pose.identity(),
            joints=np.zeros(6),
            tcp_speed=np.zeros(6),
            wrench=np.concatenate([force, np.zeros(3)]),
            mode=self.mode,
            safety=self.safety,
            moving=False,
            program_running=True,
            speed_scaling=self.speed_scaling,
        )

    def history(self, since_s: float) -> list[ArmState]:
        return [self.state()]

    def health(self) -> LinkHealth:
        return LinkHealth(not self.lost, CLOCK.now_s())

    def move_joints(self, T_base_tcp: Pose, speed_rad_s: float, acceleration_rad_s2: float) -> int:
        return self._moved("move_joints", T_base_tcp)

    def move_linear(self, T_base_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> int:
        return self._moved("move_linear", T_base_tcp)

    def move_velocity(self, velocity: Array, acceleration_m_s2: float) -> None:
        self._note("move_velocity")
        self._advance()
        self._velocity = velocity[:3]

    def comply(self, compliance: Compliance) -> None:
        self._note("comply")
        self._advance()
        self._push_n = compliance.wrench[2]
        direction = np.sign(self._push_n) * compliance.T_base_task.rotation[:, 2]
        self._velocity = compliance.limits[2] * direction

    def stop(self, deceleration_m_s2: float = 1.0) -> None:
        self.moves.append("stop")
        self._advance()
        self._velocity, self._push_n = np.zeros(3), 0.0

    def motion(self) -> MotionProgress:
        return MotionProgress(1, running=False, failed=self.motion_fails, detail="no solution")

    def zero_force_sensor(self) -> None: ...

    def kick_watchdog(self) -> None:
        self.kicks += 1

    def set_obstacles(self, boxes: tuple[Box, ...]) -> None:
        self.obstacles = boxes

    def recover(self) -> None:
        self.recoveries += 1

    def _note(self, name: str) -> None:
        if self.lost:
            raise LinkLostError("the arm is silent")
        self.moves.append(name)

    def _moved(self, name: str, target: Pose) -> int:
        self._note(name)
        self._velocity, self._push_n = np.zeros(3), 0.0
        self.pose = target
        return 1

    def _advance(self) -> None:
        now_s = CLOCK.now_s()
        travel_m = self._velocity * (now_s - self._last_s) * PACE
        self._last_s = now_s
        if self.stuck:
            return
        depth_m = self.depth_m
        going_in = -float(self.T_base_port.inverse().rotate(travel_m)[2])
        if depth_m + going_in > self.stop_depth_m and going_in > 0:
            travel_m = travel_m * max(0.0, (self.stop_depth_m - depth_m) / going_in)
        self.pose = Pose(self.pose.rotation, self.pose.translation + travel_m)


_FREE = (ChargerState.IDLE, ChargerState.RESERVED)
_SESSION = {
    ChargerRequest.RESERVE: ChargerState.RESERVED,
    ChargerRequest.UNLOCK_DOCK: ChargerState.READY,
    ChargerRequest.STOP_POWER: ChargerState.FINISHED,
    ChargerRequest.RELEASE: ChargerState.IDLE,
    ChargerRequest.ABORT: ChargerState.IDLE,
}
"""Where a request leads that is not refused."""


class StandInCharger:
    """Answers every request at once; senses the plug by its depth."""

    def __init__(self, arm: StandInArm) -> None:
        self._arm = arm
        self.lost = False
        self.lock_jams = False
        self.lock_stops_halfway = False
        self.gives_current = True
        self.full = False
        self.welded = False
        self.forced: dict[str, object] = {}
        self.requests: list[ChargerRequest] = []
        self.beats: list[Heartbeat] = []
        self.poses: list[DockPose | None] = []
        self.session = ChargerState.IDLE
        self._refused = False
        self._lock = PlugLock.UNLOCKED
        self._power = False

    def open(self) -> None: ...
    def close(self) -> None: ...

    def status(self) -> ChargerStatus:
        if self.lost:
            raise LinkLostError("the charger is silent")
        now_s = CLOCK.now_s()
        inserted = self._arm.depth_m > MATED_DEPTH_M - 0.002
        flowing = self._power and self.gives_current and not self.full
        finished = self.full and inserted
        status = ChargerStatus(
            time_s=now_s,
            state=ChargerState.CHARGING if flowing else ChargerState.FINISHED if finished else self.session,
            proximity=Proximity.LATCHED if inserted else Proximity.ABSENT,
            pilot=Pilot.C if flowing else Pilot.A,
            lock=self._lock,
            contactor_closed=(self._power and not finished) or self.welded,
            dock_enable=True,
            motion_inhibit=False,
            estop=False,
            fault_code=0,
            voltage_v=400.0 if self._power else 0.0,
            current_a=32.0 if flowing else 0.0,
            electrical_time_s=now_s,
        )
        return replace(status, **self.forced)  # type: ignore[arg-type]

    def health(self) -> LinkHealth:
        return LinkHealth(not self.lost, CLOCK.now_s())

    def traffic_before_loss(self) -> tuple[CanFrame, ...]:
        return ()

    def heartbeat(self, beat: Heartbeat) -> None:
        self.beats.append(beat)

    def request(self, request: ChargerRequest, argument: int = 0) -> int:
        self.requests.append(request)
        self._refused = request is ChargerRequest.RESERVE and self.session not in _FREE
        if self._refused:
            return len(self.requests)
        self.session = _SESSION.get(request, self.session)
        match request:
            case ChargerRequest.LOCK_PLUG | ChargerRequest.UNLOCK_PLUG if self.lock_stops_halfway:
                self._lock = PlugLock.FAULT
            case ChargerRequest.LOCK_PLUG if not self.lock_jams:
                self._lock = PlugLock.LOCKED
            case ChargerRequest.UNLOCK_PLUG:
                self._lock = PlugLock.UNLOCKED
            case ChargerRequest.ENABLE_POWER:
                self._power = True
            case ChargerRequest.STOP_POWER | ChargerRequest.ABORT:
                self._power = False
        return len(self.requests)

    def result(self, sequence: int) -> RequestResult:
        return RequestResult.REJECTED if self._refused else RequestResult.DONE

    def refusal(self) -> str:
        return ""

    def publish(self, pose: DockPose | None) -> None:
        self.poses.append(pose)


class StandInScanner:
    """A link that is up or not; the sweep itself is replaced by ``StandInLooking``."""

    def __init__(self) -> None:
        self.lost = False
        self.laser: list[bool] = []

    def open(self) -> None: ...
    def close(self) -> None: ...

    def start(self) -> None:
        self.laser.append(True)

    def stop(self) -> None:
        self.laser.append(False)

    def take(self) -> list[Profile]:
        return []

    def health(self) -> LinkHealth:
        return LinkHealth(not self.lost, None, detail="unplugged" if self.lost else "")


class StandInLooking:
    """Sweeps that take a moment, and estimates from a list: accepted or not."""

    def __init__(self, cell: Cell, config: SiteConfig, accepted: list[bool]) -> None:
        self._cell, self._config, self._accepted = cell, config, accepted
        self.scans_made = 0
        self.problem = ""
        self.cloud: Cloud | None = None

    def may_look_again(self, attempt: int) -> bool:
        return self.scans_made < len(self._config.scan.viewpoints) + attempt - 1

    def viewpoint(self):  # type: ignore[no-untyped-def]
        from controller.planning import Viewpoint

        pose = self._config.port.T_base_port.pose @ Pose(FACING, np.array([0.0, 0.0, 0.3]))
        return Viewpoint(pose, pose)

    def forget_scans(self) -> None: ...

    def sweep(self, report: Callable[[str, float, str], None]) -> None:
        self._cell.supervisor.wait(lambda: False, 1.0)
        self.scans_made += 1

    def locate(self) -> PortEstimate:
        self._cell.supervisor.wait(lambda: False, 1.0)
        accepted = self._accepted[min(self.scans_made, len(self._accepted)) - 1]
        return PortEstimate(
            port="type2",
            T_ref_port=self._config.port.T_base_port.pose,
            ref="base",
            covariance=np.eye(6) * 1e-10,
            rms_residual_m=1e-4,
            inlier_ratio=0.9,
            runner_up_margin=0.5,
            accepted=accepted,
            reasons=() if accepted else ("no rim",),
            timings_s=(("total", 0.1),),
        )


class StandInLocator:
    """Never asked: ``StandInLooking`` answers."""

    def submit(self, clouds: Sequence[Cloud], prior: Prior) -> Future[PortEstimate]:
        raise AssertionError("not used")


@dataclass
class Watch:
    """Notes what the mission says; calls ``on_state`` at each transition."""

    states: list[str] = field(default_factory=list)
    insertions: list[Insertion] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)
    outcomes: list[Outcome] = field(default_factory=list)
    on_state: Callable[[str], None] = lambda state: None

    def transition(self, source: str, event: str, target: str, time_s: float) -> None:
        self.states.append(target)
        self.on_state(target)

    def began(self, goal: Goal) -> None:
        self.goals.append(goal)

    def ended(self, outcome: Outcome, job: Progress) -> None:
        self.outcomes.append(outcome)

    def progress(self, label: str, fraction: float, detail: str) -> None: ...
    def scan(self, cloud: Cloud) -> None: ...
    def estimate(self, estimate: PortEstimate) -> None: ...

    def insertion(self, insertion: Insertion) -> None:
        self.insertions.append(insertion)


class Decisions:
    """The gate's decisions."""

    def __init__(self) -> None:
        self.refused: list[str] = []

    def command(self, name: str, detail: str, allowed: bool, reason: str) -> None:
        if not allowed:
            self.refused.append(f"{name}: {reason}")


class Script:
    """A desk that hands out jobs in turn and leaves after the last; between two jobs a test may look and act."""

    def __init__(self, *jobs: Goal | Callable[[], None]) -> None:
        self._jobs = list(jobs)
        self._under_way = False
        self.outcomes: list[Outcome] = []

    def _next(self) -> Goal | None:
        while self._jobs and not isinstance(self._jobs[0], Goal):
            self._jobs.pop(0)()  # type: ignore[operator]
        return self._jobs[0] if self._jobs else None  # type: ignore[return-value]

    @property
    def pending(self) -> Goal | None:
        return self._next()

    @property
    def leaving(self) -> bool:
        return not self._under_way and self._next() is None

    def take(self) -> Goal:
        goal = self._jobs.pop(0)
        assert isinstance(goal, Goal)
        self._under_way = True
        return goal

    def answered(self, outcome: Outcome) -> None:
        self._under_way = False
        self.outcomes.append(outcome)


class Rig:
    """One mission on stand-ins."""

    def __init__(self, folder: Path, accepted: list[bool] | None = None, port: Pose | None = None) -> None:
        self.config = load_config()
        port = port or self.config.port.T_base_port.pose
        self.arm = StandInArm(port)
        self.charger = StandInCharger(self.arm)
        self.scanner = StandInScanner()
        self.watch = Watch()
        self.decisions = Decisions()
        clock = PacedClock(PACE, CLOCK)
        self.supervisor = Supervisor(Sources(self.arm, self.charger, self.scanner), clock, CLOCK)
        self.cell = Cell(
            arm=self.arm,
            scanner=self.scanner,
            charger=self.charger,
            locator=StandInLocator(),
            supervisor=self.supervisor,
            clock=clock,
            wall=CLOCK,
            limits=Limits(
                workspace_min_m=(-2.0, -2.0, -2.0),
                workspace_max_m=(2.0, 2.0, 2.0),
                joint_speed_rad_s=1.0,
                linear_speed_m_s=0.1,
                insertion_speed_m_s=0.015,
                withdraw_speed_m_s=0.025,
                insertion_turn_rad_s=0.06,
                axial_force_n=80.0,
                lateral_force_n=30.0,
                moment_nm=6.0,
                capture_radius_m=0.002,
            ),
            reach=lambda poses: None,
            records=self.decisions,
        )
        self.T_port_tcp = Pose(FACING, np.array([0.0, 0.0, -MATED_DEPTH_M]))
        self.looking = lambda: StandInLooking(self.cell, self.config, accepted or [True])
        """Makes what looks for the port in each job."""
        self.mission = Mission(
            self.cell,
            self.config,
            self.T_port_tcp,
            self.watch,
            folder,
            self._look,  # type: ignore[arg-type]
        )

    def _look(self) -> StandInLooking:
        return self.looking()  # looked up when a job begins: a test may replace it

    def run(self) -> Outcome:
        """Run to the end; the supervisor ticks meanwhile."""
        self.supervisor.start()
        try:
            return self.mission.run()
        finally:
            self.supervisor.close()

    def serve(self, *jobs: Goal | Callable[[], None]) -> list[Outcome]:
        """What the daemon does: one job after the other; then the process leaves."""
        script = Script(*jobs)
        self.supervisor.start()
        try:
            self.mission.serve(script)
        finally:
            self.supervisor.close()
        return script.outcomes

    def at(self, state: str, act: Callable[[], None]) -> None:
        """Do something at the first entry of a state."""
        done: list[bool] = []

        def on_state(name: str) -> None:
            if name == state and not done:
                done.append(True)
                act()

        self.watch.on_state = on_state
