"""What the control worker does with the parent's requests: one loop over ur_rtde's control interface.

Rules it keeps (each a trap of ur_rtde 1.6): no motion before the watchdog is set; no kick that the parent did not ask
for; asynchronous motions only; a mode is ended only if it was started; never a synchronous stopL; never a call on a
link that is not connected, which would reconnect and crash.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from drivers.arm import messages as m
from drivers.arm.operation import Motion
from drivers.arm.script_pace import ScriptPace
from drivers.arm.worker_link import GO_AWAY_S, LINK_LOST, Link

POLL_S = 0.002
SETTLE_S = 1.0
"""Longest wait for an earlier stop to finish before a new command is taken up."""
QUICK_STOP_S = 0.03
"""A blocking stop must be shorter than the watchdog's period, as nothing is kicked meanwhile."""
BRANCH_RAD = 0.2
"""The controller's calibrated joints lie this close to the nominal ones, or on another branch."""


class LinkDeadError(Exception):
    """The control link is gone: this process ends."""


class RefusedError(Exception):
    """A command was not executed."""

    def __init__(self, refusal: m.Refusal, detail: str) -> None:
        super().__init__(detail)
        self.refusal = refusal


class ControlLoop:
    """Executes the parent's requests on one RTDEControlInterface."""

    def __init__(self, link: Link, control: Any, frequency_hz: float, watchdog_hz: float) -> None:
        self._link = link
        self._control = control
        self._watchdog_hz = watchdog_hz
        self._pace = ScriptPace(frequency_hz)
        self._armed = False
        self._velocity: m.MoveVelocity | None = None
        self._compliance: m.Comply | None = None
        self._begun: m.MoveVelocity | m.Comply | None = None
        self._turn = 0
        self._speed_end_s: float | None = None
        self._speed_deceleration = 1.0
        self._motion = Motion()
        self._status: m.Status | None = None

    def run(self) -> None:
        """Serve until the parent says quit or is gone."""
        while True:
            self._pace.wait_until_ready()
            self._link.fill(POLL_S)
            if not self._link.stop_waits() and self._link.take_kick():
                self._call("kick", self._kick)
            request = self._link.take_request()
            if request is not None:
                if isinstance(request.command, m.Quit):
                    self.leave()
                    return
                self._link.send(self._answer(request))
            self._advance()

    # --- commands ----------------------------------------------------------------------------------------------------

    def _answer(self, request: m.Request) -> m.Reply:
        try:
            joints = self._call(type(request.command).__name__, lambda: self._execute(request.command))
            if not isinstance(request.command, m.MoveVelocity | m.Comply):
                self._pace.answered()
        except RefusedError as error:
            return m.Reply(request.number, error.refusal, str(error))
        except (ValueError, RuntimeError, TypeError) as error:  # what ur_rtde raises for arguments it does not like
            return m.Reply(request.number, "refused", str(error))
        return m.Reply(request.number, joints=joints)

    def _execute(self, command: m.Command) -> m.Vector:
        if isinstance(command, m.Stop):
            self._stop(command)
            return ()
        self._settle()
        match command:
            case m.MoveJoints():
                return self._move_joints(command)
            case m.MoveLinear():
                self._begin_motion()
                before = self._operation_id()
                self._must(self._control.moveL(list(command.pose), command.speed, command.acceleration, True))
                self._motion = Motion(command.motion_id, "running", before)
            case m.MoveVelocity():
                self._refuse_if_moving()
                self._begin_mode(command, new=self._velocity is None)
                self._velocity, self._speed_end_s = command, None
            case m.Comply():
                self._begin_mode(command, new=self._compliance is None)
                self._compliance = command
            case m.ZeroForceSensor():
                self._must(self._control.zeroFtSensor())
        return ()

    def _move_joints(self, command: m.MoveJoints) -> m.Vector:
        self._begin_motion()
        joints = self._control.getInverseKinematics(list(command.pose), list(command.near))
        if len(joints) != 6:
            self._must(self._control.isProgramRunning())
            raise RefusedError("no-solution", "the controller found no joints for the pose")
        off = max(abs(a - b) for a, b in zip(joints, command.near, strict=True))
        if off > BRANCH_RAD:
            raise RefusedError("no-solution", f"the controller's joints differ from the planned ones by {off:.2f} rad")
        self._pace.answered()
        self._pace.wait_until_ready()
        self._pass_kick_on(0.0)  # the answer may have taken a good part of the watchdog's period
        before = self._operation_id()
        self._must(self._control.moveJ(list(joints), command.speed, command.acceleration, True))
        self._motion = Motion(command.motion_id, "running", before)
        return tuple(joints)

    def _begin_motion(self) -> None:
        self._refuse_if_moving()
        if self._velocity is not None:
            self._end_speed_mode()
        self._arm()

    def _refuse_if_moving(self) -> None:
        if self._motion.phase in ("running", "stopping"):
            raise RefusedError("busy", "a motion is under way")

    def _begin_mode(self, command: m.MoveVelocity | m.Comply, new: bool) -> None:
        """Enter a mode, or change it. One that has just begun must be read before another command is written."""
        self._arm()
        if new:
            self._pace.wait_until_read()
        self._must(self._stream(command))
        if new:
            self._begun = command
            self._pace.streamed()

    def _stream(self, command: m.MoveVelocity | m.Comply) -> bool:
        """Send a command that the script takes from the registers without an answer."""
        if isinstance(command, m.MoveVelocity):
            return bool(self._control.speedL(list(command.velocity), command.acceleration, 0.0))
        frame, selection = list(command.task_frame), list(command.selection)
        return bool(self._control.forceMode(frame, selection, list(command.wrench), 2, list(command.limits)))

    def _kick(self) -> None:
        """Feed the watchdog, which counts writes of the command register.

        A plain kick writes 0 there and would wipe out a streamed command that the script has not read yet; so while a
        mode is active its command is written again instead.
        """
        if not self._program_running():
            return
        if not self._armed:
            self._arm()
            return
        active = [command for command in (self._velocity, self._compliance) if command is not None]
        self._turn += 1
        if self._begun is not None and self._begun in active and not self._pace.has_read:
            self._stream(self._begun)
        elif active:
            self._stream(active[self._turn % len(active)])
        else:
            self._control.kickWatchdog()

    def _pass_kick_on(self, timeout_s: float) -> None:
        self._link.fill(timeout_s)
        if self._link.take_kick():
            self._kick()

    def _arm(self) -> None:
        """Set the controller's watchdog, once, before anything moves."""
        if not self._armed:
            self._must(self._control.setWatchdog(self._watchdog_hz))
            self._armed = True

    # --- stopping ----------------------------------------------------------------------------------------------------

    def _stop(self, command: m.Stop) -> None:
        """End by name what is active. Motion first: two script threads must not drive the arm at once."""
        if not self._program_running():
            self._forget_modes()
            return
        if self._velocity is not None:
            self._slow_down(command)
        if self._motion.phase == "running":
            before = self._operation_id()
            self._control.stopL(command.deceleration, True)
            self._motion = Motion(self._motion.motion_id, "stopping", before)
        elif self._compliance is not None and self._velocity is None:
            self._end_force_mode()

    def _slow_down(self, command: m.Stop) -> None:
        """End speed mode: at once if that is quick, else by streaming zero and ending the mode when it has worked."""
        self._speed_deceleration = command.deceleration
        quick = command.tcp_speed <= command.deceleration * QUICK_STOP_S
        if quick or self._compliance is not None:
            self._speed_deceleration = max(command.deceleration, command.tcp_speed / QUICK_STOP_S)
            self._end_speed_mode()
        elif self._speed_end_s is None:
            self._velocity = m.MoveVelocity((0.0,) * 6, command.deceleration)
            self._stream(self._velocity)
            self._speed_end_s = time.monotonic() + command.tcp_speed / command.deceleration + QUICK_STOP_S

    def _end_speed_mode(self) -> None:
        self._pace.wait_until_read()
        self._velocity, self._speed_end_s = None, None
        self._control.speedStop(self._speed_deceleration)
        self._pace.answered()

    def _end_force_mode(self) -> None:
        self._pace.wait_until_read()
        self._compliance = None
        self._control.forceModeStop()
        self._pace.answered()

    def _forget_modes(self) -> None:
        self._velocity, self._speed_end_s, self._compliance = None, None, None

    def _settle(self) -> None:
        """Wait for an earlier stop to finish, passing kicks on meanwhile."""
        deadline = time.monotonic() + SETTLE_S
        while self._speed_end_s is not None or self._motion.phase == "stopping":
            self._pass_kick_on(POLL_S)
            self._advance()
            if self._link.stop_waits() or time.monotonic() > deadline:
                raise RefusedError("busy", "the earlier stop has not finished")

    # --- following ---------------------------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Follow the motion and pending stops; report what changed."""
        running = self._program_running()
        if not running:
            self._forget_modes()
        if self._speed_end_s is not None and time.monotonic() >= self._speed_end_s:
            self._call("speedStop", self._end_speed_mode)
        was = self._motion.phase
        self._motion = self._motion.advanced(self._control.getAsyncOperationProgressEx(), running)
        if was == "stopping" and self._motion.phase != "stopping" and self._compliance is not None and running:
            self._call("forceModeStop", self._end_force_mode)
        status = m.Status(running, self._motion.motion_id, self._motion.phase)
        if status != self._status:
            self._status = status
            self._link.send(status)

    def _program_running(self) -> bool:
        if not self._control.isConnected():
            raise LinkDeadError(LINK_LOST)
        return bool(self._control.isProgramRunning())

    def _operation_id(self) -> int:
        return int(self._control.getAsyncOperationProgressEx().operationId())

    def _must(self, accepted: bool) -> None:
        if accepted:
            return
        if not self._program_running():
            raise RefusedError("program-stopped", "the control script is not running")
        raise RefusedError("refused", "the controller did not take the command (safety stop, or script not ready)")

    def _call(self, name: str, action: Callable[[], Any]) -> Any:
        """Run one action that may block, so that the beat can tell the parent for how long."""
        self._link.busy(name)
        try:
            return action()
        finally:
            self._link.busy("")

    def leave(self) -> None:
        """Stop what moves, then end the script: nothing of it outlives this process."""
        if self._control.isConnected() and self._control.isProgramRunning():
            self._stop(m.Stop(deceleration=2.0, tcp_speed=0.0))
            deadline = time.monotonic() + GO_AWAY_S
            while self._motion.phase == "stopping" and time.monotonic() < deadline:
                time.sleep(POLL_S)
                self._advance()
            if self._program_running():
                self._control.stopScript()
