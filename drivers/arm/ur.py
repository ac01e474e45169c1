"""A Universal Robots e-Series arm over RTDE: the ``Arm`` of ``drivers/base.py``.

The state link lives here, the control link in a worker process (``ur_worker.py``) that may die without taking portdock
along. Whatever moves is watched by the controller's own watchdog: it is set before the first motion, and from then on
the program stops when the supervisor's kicks do not come. After that, as after any safety stop, only ``recover``
makes the arm take commands again, and no motion from before goes on.
"""

from __future__ import annotations

import logging
import threading

import numpy as np

from drivers.arm import messages as m
from drivers.arm import validate
from drivers.arm.errors import ArmBusyError, InvalidCommandError, ProgramStoppedError, UnreachableError
from drivers.arm.links import Links
from drivers.arm.motion import MotionTracker
from drivers.arm.settings import UrSettings
from drivers.arm.true_pose import told_pose, true_states
from drivers.arm.worker_client import CALL_S
from drivers.base import (
    ArmCommandRecord,
    ArmState,
    Box,
    ByteSink,
    Clock,
    CommandRejectedError,
    Compliance,
    LinkHealth,
    LinkLostError,
    MonotonicClock,
    MotionProgress,
    NullSink,
)
from perception.geometry import Array, Pose

log = logging.getLogger(__name__)

STOP_S = 0.5
"""A stop that is not answered within this goes over the dashboard."""


class UrArm:
    """One arm. All methods may be called from several threads; none but ``open``, ``close`` and ``recover`` is slow."""

    def __init__(
        self, settings: UrSettings, sink: ByteSink | None = None, clock: Clock | None = None, links: Links | None = None
    ) -> None:
        """``links``: both links to the controller; a replay gives some that play recorded states."""
        self._settings = settings
        self._sink = sink or NullSink()
        self._clock = clock or MonotonicClock()
        self._links = links or Links(settings, self._sink, self._clock)
        self._tracker = MotionTracker()
        self._newest_true: tuple[ArmState, ArmState] | None = None
        self._lock = threading.Lock()
        self._obstacles: tuple[Box, ...] = ()

    def open(self) -> None:
        """Check the robot, start both links, set TCP and payload and read them back. Raises LinkOpenError."""
        try:
            self._links.open()
        except BaseException:
            self._links.close()
            raise

    def close(self) -> None:
        """Stop any motion, end the script and both links. Idempotent."""
        self._links.close()

    def recover(self) -> None:
        """After an operator's reset: a new control link and script, with no memory of old motions.

        Never releases a safety stop: raises SafetyStopError while one is active. Raises LinkOpenError. State goes on
        being received in either case, if the state link is sound.
        """
        self._tracker.forget()
        self._links.restart()

    # --- state -------------------------------------------------------------------------------------------------------

    def state(self) -> ArmState:
        """The newest sample. Raises StateLinkLostError or FrozenStateError when it is stale."""
        told, newest = self._told(), self._newest_true
        if newest is None or newest[0] is not told:  # asked for several times for each sample
            newest = self._newest_true = told, true_states([told], self._settings)[0]
        return newest[1]

    def history(self, since_s: float) -> list[ArmState]:
        """Samples received after ``since_s``, oldest first."""
        return true_states(self._links.telemetry.history(since_s), self._settings)

    def health(self) -> LinkHealth:
        """Of both links: up only if state is fresh and the control link lives."""
        return self._links.health()

    def motion(self) -> MotionProgress:
        """What became of the last motion."""
        lost = self._links.lost
        over = self._links.ended or (lost and f"link lost: {lost}")
        if over is not None:
            return self._tracker.progress(m.Status(False, 0, "idle"), 0.0, self._links.newest, over)
        worker = self._links.worker
        return self._tracker.progress(worker.status, worker.status_s, self._links.newest, None)

    @property
    def obstacles(self) -> tuple[Box, ...]:
        """What ``set_obstacles`` was told last."""
        return self._obstacles

    def set_obstacles(self, boxes: tuple[Box, ...]) -> None:
        """Boxes seen in the present scene (open cover, panel), to keep clear of beside the configured ones."""
        self._obstacles = boxes

    def set_output(self, number: int, level: bool) -> None:
        """Switch a standard digital output, 0 to 7. Raises LinkLostError, ProtocolError."""
        self._links.set_output(number, level)

    # --- motions -----------------------------------------------------------------------------------------------------

    def move_joints(self, T_base_tcp: Pose, speed_rad_s: float, acceleration_rad_s2: float) -> int:
        """Joint motion to the pose on the branch nearest to the present joints. Returns the motion's id."""
        s, state = self._settings, self._told()
        pose = validate.target(told_pose(T_base_tcp, state.joints, s), s)
        speed = validate.within("joint speed", speed_rad_s, s.caps.joint_speed_rad_s, "rad/s")
        acceleration = validate.within(
            "joint acceleration", acceleration_rad_s2, s.caps.joint_acceleration_rad_s2, "rad/s2"
        )
        joints = validate.joint_target(pose, state, s)
        validate.clear(validate.joint_path(state.joints, joints), s, self._obstacles)
        near = tuple(joints.tolist())
        with self._lock:
            motion_id = self._tracker.next_id()
            command = m.MoveJoints(motion_id, tuple(pose.vector.tolist()), near, speed, acceleration)
            self._do("move_joints", command, (*command.pose, speed, acceleration))
            self._tracker.begin(motion_id, pose)
        return motion_id

    def move_linear(self, T_base_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> int:
        """Straight motion to the pose; the whole way is checked first. Returns the motion's id."""
        s, state = self._settings, self._told()
        pose = validate.target(told_pose(T_base_tcp, state.joints, s), s)
        speed = validate.within("speed", speed_m_s, s.caps.tcp_speed_m_s, "m/s")
        acceleration = validate.within("acceleration", acceleration_m_s2, s.caps.tcp_acceleration_m_s2, "m/s2")
        validate.clear(validate.line(pose, state, s), s, self._obstacles)
        with self._lock:
            motion_id = self._tracker.next_id()
            command = m.MoveLinear(motion_id, tuple(pose.vector.tolist()), speed, acceleration)
            self._do("move_linear", command, (*command.pose, speed, acceleration))
            self._tracker.begin(motion_id, pose)
        return motion_id

    def move_velocity(self, velocity: Array, acceleration_m_s2: float) -> None:
        """Constant velocity (6,) in base axes until stopped; call again to change it. Works within force mode too."""
        s = self._settings
        self.state()
        v = tuple(validate.velocity(velocity, s).tolist())
        acceleration = validate.within("acceleration", acceleration_m_s2, s.caps.tcp_acceleration_m_s2, "m/s2")
        self._do("move_velocity", m.MoveVelocity(v, acceleration), (*v, acceleration))

    def comply(self, compliance: Compliance) -> None:
        """Enter force mode, or change its parameters."""
        self.state()
        c = validate.compliance(compliance, self._settings)
        frame = tuple(c.T_base_task.vector.tolist())
        command = m.Comply(frame, tuple(map(int, c.selection)), tuple(c.wrench), tuple(c.limits))
        self._do("comply", command, (*frame, *map(float, c.selection), *c.wrench, *c.limits))

    def stop(self, deceleration_m_s2: float = 1.0) -> None:
        """End whatever motion or mode is active. With a link lost or state stale, the dashboard ends the program too.

        Raises LinkLostError if no way leads to the controller; its watchdog then stops the arm.
        """
        if not (np.isfinite(deceleration_m_s2) and deceleration_m_s2 > 0):
            raise InvalidCommandError(f"deceleration {deceleration_m_s2} m/s2 is not above 0")
        state = self._links.newest
        speed = 0.0 if state is None else float(np.linalg.norm(state.tcp_speed[:3]))
        self._tracker.stop_asked()
        try:
            self._do("stop", m.Stop(float(deceleration_m_s2), speed), (float(deceleration_m_s2),), STOP_S)
            proven = self._links.fresh
        except LinkLostError:
            proven = False
        if not proven:
            log.warning("a link to the arm is lost: the dashboard ends the program")
            self._links.end_program()

    def zero_force_sensor(self) -> None:
        """Take the present wrench as zero. Refused while the arm moves; out of contact is the caller's duty."""
        if self.state().moving:
            raise InvalidCommandError(
                "the force sensor is not zeroed while the arm moves", remedy="Stop the arm first."
            )
        self._do("zero_force_sensor", m.ZeroForceSensor(), ())

    def kick_watchdog(self) -> None:
        """Pass the supervisor's sign of life on; does not wait. Raises ControlLinkLostError."""
        self._links.kick()

    # --- inside ------------------------------------------------------------------------------------------------------

    def _told(self) -> ArmState:
        """The newest sample in the arm's own words. Raises as ``state``."""
        return self._links.telemetry.fresh(self._settings.freshness_s)

    def _do(self, name: str, command: m.Command, arguments: tuple[float, ...], timeout_s: float = CALL_S) -> None:
        """Send a command, record it with its result, and turn a refusal into its error."""
        result = "lost"
        try:
            reply = self._links.ask(command, timeout_s)
            result = f"{reply.refusal}: {reply.detail}" if reply.refusal else "ok"
        finally:
            self._sink.arm_command(ArmCommandRecord(self._clock.now_s(), name, arguments, result))
        if reply.refusal:
            raise _REFUSALS.get(reply.refusal, CommandRejectedError)(f"{name}: {reply.detail}")


_REFUSALS: dict[str, type[CommandRejectedError]] = {
    "busy": ArmBusyError,
    "program-stopped": ProgramStoppedError,
    "no-solution": UnreachableError,
}
