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
from drivers.arm.collision import Box
from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import (
    ArmBusyError,
    ControlLinkLostError,
    InvalidCommandError,
    ProgramStoppedError,
    ReadBackError,
    UnreachableError,
)
from drivers.arm.motion import MotionTracker
from drivers.arm.opening import check_robot, start_error
from drivers.arm.settings import UrSettings
from drivers.arm.telemetry import Telemetry
from drivers.arm.worker_client import WorkerClient
from drivers.base import (
    ArmCommandRecord,
    ArmState,
    ByteSink,
    Clock,
    CommandRejectedError,
    Compliance,
    DriverError,
    LinkHealth,
    LinkLostError,
    MonotonicClock,
    MotionProgress,
    NullSink,
    ProtocolError,
    SafetyMode,
)
from perception.geometry import Array, Pose

log = logging.getLogger(__name__)

SAFE = (SafetyMode.NORMAL, SafetyMode.REDUCED)
SAME_TCP_M, SAME_TCP_RAD = 1e-5, 1e-4
SAME_PAYLOAD_KG, SAME_COG_M = 0.01, 0.001
PAYLOAD_SHOWN_S = 1.0
"""Within this the controller's state must show the payload that was set."""


class UrArm:
    """One arm. All methods may be called from several threads; none but ``open``, ``close`` and ``recover`` is slow."""

    def __init__(self, settings: UrSettings, sink: ByteSink | None = None, clock: Clock | None = None) -> None:
        self._settings = settings
        self._sink = sink or NullSink()
        self._clock = clock or MonotonicClock()
        self._telemetry: Telemetry | None = None
        self._worker: WorkerClient | None = None
        self._tracker = MotionTracker()
        self._lock = threading.Lock()
        self._safe = True
        self._obstacles: tuple[Box, ...] = ()

    # --- life --------------------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Check the robot, start both links, set TCP and payload and read them back. Raises LinkOpenError."""
        check_robot(self._settings, self._clock)
        try:
            self._open_telemetry()
            self._open_worker()
            self._check_payload()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Stop any motion, end the script and both links. Idempotent."""
        self._close_worker()
        self._close_telemetry()

    def recover(self) -> None:
        """After an operator's reset: a new control link and script, with no memory of old motions.

        Never releases a safety stop: raises SafetyStopError while one is active. Raises LinkOpenError. State goes on
        being received in either case, if the state link is sound.
        """
        self._close_worker()
        self._tracker.forget()
        self._end_program_quietly()
        check_robot(self._settings, self._clock)
        if self._telemetry is None or not self._telemetry.is_fresh(self._settings.freshness_s):
            self._close_telemetry()
            self._open_telemetry()
        try:
            self._open_worker()
            self._check_payload()
        except BaseException:
            self._close_worker()
            raise

    def _close_worker(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.quit()

    def _close_telemetry(self) -> None:
        telemetry, self._telemetry = self._telemetry, None
        if telemetry is not None:
            telemetry.close()

    def _open_telemetry(self) -> None:
        s = self._settings
        self._safe = True
        self._telemetry = Telemetry(s.host, s.frequency_hz, s.T_flange_tcp, self._sink, self._clock, self._on_state)

    def _open_worker(self) -> None:
        s = self._settings
        worker = WorkerClient(self._on_worker_lost)
        self._worker = worker
        tcp = tuple(s.T_flange_tcp.vector.tolist())
        start = m.Start(
            s.host, s.frequency_hz, s.upper_registers, s.watchdog_hz, tcp, s.payload_kg, s.centre_of_gravity_m
        )
        answer = worker.start(start, s.start_timeout_s)
        if isinstance(answer, m.StartFailed):
            raise start_error(answer.reason)
        shown = Pose.from_vector(answer.tcp)
        if shown.distance_to(s.T_flange_tcp) > SAME_TCP_M or shown.angle_to(s.T_flange_tcp) > SAME_TCP_RAD:
            raise ReadBackError("the controller reports another TCP than the one that was set")

    def _check_payload(self) -> None:
        s = self._settings
        deadline = self._clock.now_s() + PAYLOAD_SHOWN_S
        while True:
            mass, cog = self._link().payload()
            if abs(mass - s.payload_kg) <= SAME_PAYLOAD_KG and np.allclose(cog, s.centre_of_gravity_m, atol=SAME_COG_M):
                return
            if self._clock.now_s() > deadline:
                raise ReadBackError(
                    f"the controller reckons with {mass:.2f} kg at {np.round(cog, 3).tolist()} m, "
                    f"not {s.payload_kg:.2f} kg at {list(s.centre_of_gravity_m)} m"
                )
            self._clock.sleep(0.01)

    # --- state -------------------------------------------------------------------------------------------------------

    def state(self) -> ArmState:
        """The newest sample. Raises StateLinkLostError or FrozenStateError when it is stale."""
        return self._link().fresh(self._settings.freshness_s)

    def history(self, since_s: float) -> list[ArmState]:
        """Samples received after ``since_s``, oldest first."""
        return self._link().history(since_s)

    def health(self) -> LinkHealth:
        """Of both links: up only if state is fresh and the control link lives."""
        if self._telemetry is None or self._worker is None:
            return LinkHealth(False, None, detail="not open")
        seen = self._telemetry.health(self._settings.freshness_s)
        lost = self._worker.lost
        return LinkHealth(seen.up and lost is None, seen.last_rx_s, seen.counters, lost or "")

    def motion(self) -> MotionProgress:
        """What became of the last motion."""
        worker, telemetry = self._worker, self._telemetry
        lost = "the control link is not open" if worker is None else worker.lost
        if telemetry is None or not telemetry.is_fresh(self._settings.freshness_s):
            lost = lost or "no fresh state"
        state = None if telemetry is None else telemetry.newest()
        status, since_s = (m.Status(False, 0, "idle"), 0.0) if worker is None else (worker.status, worker.status_s)
        return self._tracker.progress(status, since_s, state, lost)

    def set_obstacles(self, boxes: tuple[Box, ...]) -> None:
        """Boxes seen in the present scene (open cover, panel), to keep clear of beside the configured ones."""
        self._obstacles = boxes

    # --- motions -----------------------------------------------------------------------------------------------------

    def move_joints(self, T_base_tcp: Pose, speed_rad_s: float, acceleration_rad_s2: float) -> int:
        """Joint motion to the pose on the branch nearest to the present joints. Returns the motion's id."""
        s, state = self._settings, self.state()
        pose = validate.target(T_base_tcp, s)
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
        s, state = self._settings, self.state()
        pose = validate.target(T_base_tcp, s)
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
        """End whatever motion or mode is active. With the control link lost, the dashboard stops the program instead.

        Raises LinkLostError if neither way leads to the controller; its watchdog then stops the arm.
        """
        if not (np.isfinite(deceleration_m_s2) and deceleration_m_s2 > 0):
            raise InvalidCommandError(f"deceleration {deceleration_m_s2} m/s2 is not above 0")
        state = None if self._telemetry is None else self._telemetry.newest()
        speed = 0.0 if state is None else float(np.linalg.norm(state.tcp_speed[:3]))
        self._tracker.stop_asked()
        try:
            self._do("stop", m.Stop(float(deceleration_m_s2), speed), (float(deceleration_m_s2),))
        except LinkLostError:
            log.warning("the control link is lost: stopping the program over the dashboard")
            self._end_program()

    def zero_force_sensor(self) -> None:
        """Take the present wrench as zero. Refused while the arm moves; out of contact is the caller's duty."""
        if self.state().moving:
            raise InvalidCommandError(
                "the force sensor is not zeroed while the arm moves", remedy="Stop the arm first."
            )
        self._do("zero_force_sensor", m.ZeroForceSensor(), ())

    def kick_watchdog(self) -> None:
        """Pass the supervisor's sign of life on; does not wait. Raises ControlLinkLostError."""
        self._control().kick()

    # --- inside ------------------------------------------------------------------------------------------------------

    def _link(self) -> Telemetry:
        if self._telemetry is None:
            raise LinkLostError("the arm's link is not open")
        return self._telemetry

    def _control(self) -> WorkerClient:
        if self._worker is None:
            raise ControlLinkLostError("the arm's control link is not open")
        return self._worker

    def _do(self, name: str, command: m.Command, arguments: tuple[float, ...]) -> None:
        """Send a command, record it with its result, and turn a refusal into its error."""
        result = "lost"
        try:
            reply = self._control().ask(command)
            result = f"{reply.refusal}: {reply.detail}" if reply.refusal else "ok"
        finally:
            self._sink.arm_command(ArmCommandRecord(self._clock.now_s(), name, arguments, result))
        if reply.refusal:
            raise _REFUSALS.get(reply.refusal, CommandRejectedError)(f"{name}: {reply.detail}")

    def _on_state(self, state: ArmState) -> None:
        """Reader thread: when a safety stop begins, end the program, so that no release lets the old motion go on."""
        safe = state.safety in SAFE
        if self._safe and not safe:
            log.warning("safety mode %s: the program is ended", state.safety.name)
            threading.Thread(target=self._end_program_quietly, name="arm-end-program", daemon=True).start()
        self._safe = safe

    def _on_worker_lost(self, reason: str) -> None:
        """Monitor thread: the watchdog would stop the arm; the dashboard is quicker where it can be reached."""
        self._end_program_quietly()

    def _end_program(self) -> None:
        try:
            with Dashboard(self._settings.host, self._settings.connect_timeout_s) as dashboard:
                dashboard.stop()
        except ProtocolError as error:  # such as no program to stop
            log.warning("%s", error)
        except LinkLostError as error:
            raise ControlLinkLostError(f"the arm cannot be stopped over the network: {error}") from error

    def _end_program_quietly(self) -> None:
        try:
            self._end_program()
        except DriverError as error:
            log.error("%s", error)


_REFUSALS: dict[str, type[CommandRejectedError]] = {
    "busy": ArmBusyError,
    "program-stopped": ProgramStoppedError,
    "no-solution": UnreachableError,
}
