"""The real insertion on the emulated arm and port in one process, in emulated time: gate, cell and contact are real.

Only the wires are missing: a command takes effect ``LATENCY_S`` after it is given, and whoever waits looks every
``LOOK_S``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from controller.cell import Cell
from controller.config import SiteConfig, load_config
from controller.heartbeat import Facts
from controller.planning import DockPlan, plan_on_axis
from controller.port_files import load_port
from controller.states import State
from controller.wiring import limits_of
from drivers.base import (
    ArmState,
    ChargerState,
    ChargerStatus,
    Compliance,
    Pilot,
    PlugLock,
    Proximity,
    RobotMode,
    SafetyMode,
)
from mocks.ur.arm import Arm, ForceMode, Sensor
from mocks.ur.environment import PortEnvironment
from mocks.ur.kinematics import MODELS, Kinematics
from mocks.ur.motion import ToolVelocity
from mocks.world.blackboard import Blackboard
from mocks.world.spec import WorldSpec
from perception.geometry import Array, Pose

DT = 0.008
LATENCY_S = 0.016
LOOK_S = 0.016
HOME = np.array([2.8, -1.8, 1.8, -0.2, 1.5, 2.9])


class EmulatedArm:
    """``Arm`` of the drivers on the mock's arm, advanced by the rig; keeps every sample."""

    def __init__(self, mock: Arm, T_flange_tcp: Pose) -> None:
        self.mock = mock
        self.time_s = 0.0
        self.peak_n = 0.0
        self.states: list[ArmState] = []
        self.before_step: Callable[[], None] = lambda: None
        self._T_flange_tcp = T_flange_tcp

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.before_step()
            self.mock.step(DT)
            self.time_s += DT
            self.peak_n = max(self.peak_n, float(np.linalg.norm(self.mock.true_wrench[:3])))
            self.states.append(self._sample())

    def _sample(self) -> ArmState:
        matrix = self.mock.reference.T_base_tcp
        speed = self.mock.tool_speed()
        return ArmState(
            time_s=self.time_s,
            device_time_s=self.time_s,
            T_base_tcp=Pose(matrix[:3, :3].copy(), matrix[:3, 3].copy()),
            T_flange_tcp=self._T_flange_tcp,
            joints=self.mock.q,
            tcp_speed=speed,
            wrench=self.mock.wrench,
            mode=RobotMode.RUNNING,
            safety=SafetyMode.NORMAL,
            moving=bool(np.abs(speed[:3]).max() > 0.001),
            program_running=True,
            speed_scaling=1.0,
        )

    def state(self) -> ArmState:
        return self.states[-1]

    def history(self, since_s: float) -> list[ArmState]:
        first = len(self.states)
        while first > 0 and self.states[first - 1].time_s > since_s:
            first -= 1
        return self.states[first:]

    def move_velocity(self, velocity: Array, acceleration_m_s2: float) -> None:
        self.run(LATENCY_S)
        self.mock.start(ToolVelocity(np.asarray(velocity), acceleration_m_s2))

    def comply(self, compliance: Compliance) -> None:
        self.run(LATENCY_S)
        c = compliance
        wrench, limits = np.array(c.wrench), np.array(c.limits)
        self.mock.enter_force_mode(ForceMode(c.T_base_task.matrix, c.selection, wrench, limits))
        self.mock.force_gain = 0.5  # what ur_rtde's script sets

    def stop(self, deceleration_m_s2: float = 1.0) -> None:
        self.run(LATENCY_S)
        self.mock.halt(deceleration_m_s2, linear=True)

    def zero_force_sensor(self) -> None:
        self.run(0.2)
        self.mock.sensor.zero()


class EmulatedCharger:
    """Senses the plug and holds the lock as the test says."""

    def __init__(self, board: Blackboard) -> None:
        self._board = board
        self.lock = PlugLock.UNLOCKED

    def status(self) -> ChargerStatus:
        proximity = Proximity.LATCHED if self._board.plug().seated else Proximity.ABSENT
        return ChargerStatus(
            0.0, ChargerState.READY, proximity, Pilot.B, self.lock, False, True, False, False, 0, 0.0, 0.0, 0.0
        )


class EmulatedTime:
    """Clock and supervisor: waiting lets the arm run."""

    def __init__(self, arm: EmulatedArm) -> None:
        self._arm = arm
        self.facts = Facts(state=State.INSERTING)
        self.trip = None
        self.tripped_meanwhile = False
        self.lets_back_off = False

    def now_s(self) -> float:
        return self._arm.time_s

    def sleep(self, seconds: float) -> None:
        self._arm.run(seconds)

    def wait(self, until: Callable[[], bool], timeout_s: float | None = None) -> bool:
        end_s = np.inf if timeout_s is None else self.now_s() + timeout_s
        while not until():
            if self.now_s() >= end_s:
                return False
            self._arm.run(LOOK_S)
        return True

    def wait_ticks(self, count: int) -> None:
        self._arm.run(count * LOOK_S)

    def raise_if_paused(self) -> None:
        """Nobody walks into this rig, and inserting does not pause."""


class Commands:
    """The gate's decisions."""

    def __init__(self) -> None:
        self.given: list[tuple[str, str]] = []

    def command(self, name: str, detail: str, allowed: bool, reason: str) -> None:
        self.given.append((name, detail if allowed else f"REFUSED {reason}"))


class InsertionRig:
    """A plug in front of a port, off by ``error`` (in port axes), on the plan of somebody who does not know that."""

    def __init__(
        self,
        folder: Path,
        error: Pose,
        rng: np.random.Generator,
        *,
        start_mm: float = 8.0,
        port: str = "ccs2",
        tool_error: Pose | None = None,
        joint_offsets: Array | None = None,
        **world: Any,
    ) -> None:
        """``tool_error``: the true TCP in the believed one; ``joint_offsets``: true joint angles minus the reported."""
        self.config: SiteConfig = load_config()
        self.settings = self.config.insertion.on(port)
        description = load_port(port)
        self.truth = self.config.port.T_base_port.pose
        tcp = self.config.arm.T_flange_tcp.pose
        believed = self.truth @ error
        motion = self.config.motion.model_copy(update={"pre_contact_mm": start_mm})
        self.plan: DockPlan = plan_on_axis(believed, description.T_port_tcp, motion)
        self.world = WorldSpec(
            seed=0,
            port=port,
            T_base_port=tuple(self.truth.vector),  # type: ignore[arg-type]
            T_flange_scanner=(0.0,) * 6,  # type: ignore[arg-type]
            T_flange_tcp=tuple((tcp @ (tool_error or Pose.identity())).vector),  # type: ignore[arg-type]
            T_port_tcp=tuple(description.T_port_tcp.vector),  # type: ignore[arg-type]
            **world,
        )
        if not (folder / "blackboard").exists():
            Blackboard.create(folder).close()
        self.board = Blackboard.attach(folder)
        kinematics = Kinematics(MODELS["ur10e"])
        q = kinematics.inverse((self.plan.pre_contact @ tcp.inverse()).matrix, HOME)
        assert q is not None
        sensor = Sensor(rng, 0.3, 0.01, 3.0, 0.1)
        mock = Arm(kinematics, q, PortEnvironment(self.world, self.board), sensor, joint_offsets)
        mock.set_tcp(tcp.matrix)
        self.arm = EmulatedArm(mock, tcp)
        self.arm.run(0.2)
        self.time = EmulatedTime(self.arm)
        self.charger = EmulatedCharger(self.board)
        self.commands = Commands()
        emulated: Any = self.arm
        self.cell = Cell(
            arm=emulated,
            scanner=None,  # type: ignore[arg-type]
            charger=self.charger,  # type: ignore[arg-type]
            locator=None,  # type: ignore[arg-type]
            supervisor=self.time,  # type: ignore[arg-type]
            clock=self.time,
            wall=self.time,
            limits=limits_of(self.config, description),
            reach=lambda poses: None,
            records=self.commands,
            T_base_port=believed,
        )

    @property
    def depth_m(self) -> float:
        """How deep the plug truly is."""
        return self.board.plug().depth_m

    def in_state(self, state: State) -> None:
        self.time.facts.state = state
