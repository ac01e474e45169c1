"""The control script that ur_rtde uploads, emulated natively: commands by number in input registers.

The uploaded text is only read for the register offset and the injected path; what each command does is written here
by hand, after the behaviour of ur_rtde 1.6.5's script: real-time commands run in every step, others once until the
client takes the command back, progress of asynchronous motions stands in output integer register 2.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mocks.spatial import matrix_of
from mocks.ur.arm import ForceMode
from mocks.ur.control_queries import QUERIES
from mocks.ur.motion import Halt, JointMove, JointVelocity, LinearMove, Motion, Servo, ToolVelocity
from mocks.ur.program import Thread, ThreadedProgram
from mocks.ur.script_text import moves_in
from perception.geometry import Array

if TYPE_CHECKING:
    from mocks.ur.controller import Controller

REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
STOP_SCRIPT = 255
CONTACT_DETECTED = 254
READY, DONE = 1, 2


class ControlScript(ThreadedProgram):
    """One run of the uploaded script."""

    name = "rtde_control"

    def __init__(self, controller: Controller, text: str) -> None:
        super().__init__(controller)
        self.offset = _register_offset(text)
        self.path = moves_in(text)
        self.internal_command = 0
        self.contact_step_back = 0
        self._progress_writes = self._operation = 0
        self._stop_by_tool = False
        self._unseen = False
        self._commands: dict[int, Callable[[], Thread | None]] = {
            1: self._movej, 2: self._movej_ik, 3: self._movel, 4: self._movel_fk, 7: self._force_mode_stop,
            12: self._servoc, 15: self._speed_stop, 16: self._servo_stop, 33: self._stop, 34: self._stop,
            41: self._jog, 42: self._jog_stop, 45: self._move_path, 51: self._move_until_contact,
            62: self._contact_detection_start, 63: self._contact_detection_stop,
            CONTACT_DETECTED: self._back_to_contact,
        }  # fmt: skip
        self._streams: dict[int, Callable[[], None]] = {
            6: self._force_mode, 9: self._speedj, 10: self._speedl, 11: self._servoj, 24: self._servol,
        }  # fmt: skip
        self.arm.force_gain = 0.5

    # --- registers --------------------------------------------------------------------------------------------------

    def integer(self, k: int) -> int:
        """Input integer register of this script."""
        return self.controller.registers.in_int[self.offset + k]

    def numbers(self, first: int, count: int = 6) -> Array:
        """Input double registers of this script."""
        start = self.offset + first
        return np.array(self.controller.registers.in_double[start : start + count])

    def pose(self, first: int = 0) -> Array:
        """Pose (4, 4) from six input double registers."""
        return matrix_of(self.numbers(first))

    def write_integer(self, k: int, value: int) -> None:
        """Output integer register of this script."""
        self.controller.registers.out_int[self.offset + k] = value

    def write_numbers(self, values: Array, first: int = 0) -> None:
        """Output double registers of this script."""
        start = self.offset + first
        self.controller.registers.out_double[start : start + len(values)] = [float(value) for value in values]

    def signal_progress(self, value: int) -> None:
        """Asynchronous status: bits 0-14 progress, 15 running, 16-22 write count, 24-30 operation; -1 is finished."""
        self._progress_writes = (self._progress_writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        status = (self._progress_writes << 16) + (self._operation << 24)
        self.write_integer(2, status + (min(value, 0x7FFF) | 0x8000) if value >= 0 else status)

    # --- main loop --------------------------------------------------------------------------------------------------

    def main(self) -> Thread:
        self.signal_progress(-1)
        self.write_integer(0, READY)
        executed = False
        while True:
            command = self._next_command()
            self._unseen = False
            if command == STOP_SCRIPT:
                return
            if command in REALTIME:
                self._stream(command)
                self.write_integer(0, READY)
            elif command == 0:
                executed = False
                self.write_integer(0, READY)
            elif not executed:
                yield from self._execute(command)
                self.write_integer(0, DONE)
                executed = True
            yield

    def before_inputs(self) -> None:
        """A streamed command that comes and goes within one step is carried out all the same."""
        if self._unseen and self.integer(0) in REALTIME:
            self._stream(self.integer(0))
        self._unseen = True

    def _next_command(self) -> int:
        command = self.integer(0)
        if command == 0:
            command, self.internal_command = self.internal_command, 0
        return command

    def _stream(self, command: int) -> None:
        if command in self._streams:
            self._streams[command]()
        elif command in QUERIES:
            QUERIES[command](self)

    def _execute(self, command: int) -> Thread:
        if command in QUERIES:
            QUERIES[command](self)
        elif command in self._commands:
            thread = self._commands[command]()
            if thread is not None:
                yield from thread

    # --- motions ----------------------------------------------------------------------------------------------------

    def _movej(self) -> Thread | None:
        return self._move(lambda: JointMove(self.numbers(0), *self.numbers(6, 2)))

    def _movej_ik(self) -> Thread | None:
        q = self.joints_for(self.pose())
        return self._move(lambda: JointMove(q, *self.numbers(6, 2)))

    def _movel(self) -> Thread | None:
        return self._move(lambda: LinearMove(self.pose(), *self.numbers(6, 2)))

    def _movel_fk(self) -> Thread | None:
        reference = self.arm.reference
        target = reference.kinematics.flange(self.numbers(0)) @ reference.T_flange_tcp
        return self._move(lambda: LinearMove(target, *self.numbers(6, 2)))

    def _move(self, make: Callable[[], Motion]) -> Thread | None:
        self._stop_async_move()
        if self.integer(1) != 1:
            return self.wait_for(self.arm.start(make()))
        self.run("move", self._async(self.wait_for(self.arm.start(make()))))
        return None

    def _move_path(self) -> Thread | None:
        self._stop_async_move()
        if self.integer(1) != 1:
            return self._along_path()
        self.run("move", self._async(self._along_path()))
        return None

    def _along_path(self) -> Thread:
        for index, move in enumerate(self.path):
            self.signal_progress(index)
            yield from self.wait_for(self.arm.start(move.motion(self)))

    def _async(self, thread: Thread) -> Thread:
        self.signal_progress(0)
        yield from thread
        self.signal_progress(-1)

    def _stop_async_move(self) -> None:
        if self.threads.pop("move", None) is not None:
            self.arm.halt()
            self.signal_progress(-1)

    def _stop(self) -> Thread | None:
        if self.threads.pop("stop", None) is not None:
            self.signal_progress(-1)
        else:
            self._stop_async_move()
        deceleration = float(self.numbers(0, 1)[0])
        if self.integer(1) != 1:
            return self._halting(deceleration, self._stop_by_tool)
        self._stop_by_tool = True
        self.run("stop", self._async(self._halting(deceleration, linear=True)))
        return None

    def _halting(self, deceleration: float, linear: bool) -> Thread:
        yield from self.wait_for(self.arm.start(Halt(deceleration, linear)))

    # --- streamed motions ---------------------------------------------------------------------------------------------

    def _speedl(self) -> None:
        self.arm.start(ToolVelocity(self.numbers(0), float(self.numbers(6, 1)[0])))

    def _speedj(self) -> None:
        self.arm.start(JointVelocity(self.numbers(0), float(self.numbers(6, 1)[0])))

    def _speed_stop(self) -> Thread:
        linear = isinstance(self.arm.motion, ToolVelocity)
        return self._halting(float(self.numbers(0, 1)[0]), linear)

    def _servoj(self) -> None:
        self.arm.start(Servo(self.numbers(0), float(self.numbers(9, 1)[0])))

    def _servol(self) -> None:
        self.arm.start(Servo(self.joints_for(self.pose()), float(self.numbers(9, 1)[0])))

    def _servoc(self) -> None:
        self.arm.start(LinearMove(self.pose(), *self.numbers(6, 2)))

    def _servo_stop(self) -> Thread:
        return self._halting(float(self.numbers(0, 1)[0]), linear=True)

    def _jog(self) -> None:
        velocity, feature = self.numbers(0), round(float(self.numbers(6, 1)[0]))
        R = (np.eye(3), self.arm.reference.T_base_tcp[:3, :3], self.pose(8)[:3, :3])[min(feature, 2)]
        turned = np.concatenate([R @ velocity[:3], R @ velocity[3:]])
        self.arm.start(ToolVelocity(turned, float(self.numbers(7, 1)[0])))

    def _jog_stop(self) -> Thread:
        return self._halting(1.2, linear=True)

    # --- force and contact --------------------------------------------------------------------------------------------

    def _force_mode(self) -> None:
        selection = tuple(self.integer(k) != 0 for k in range(2, 8))
        self.arm.enter_force_mode(ForceMode(self.pose(), selection, self.numbers(6), self.numbers(12)))

    def _force_mode_stop(self) -> Thread:
        self.arm.leave_force_mode()
        return self._halting(10.0, linear=True)

    def _move_until_contact(self) -> Thread:
        velocity, direction = self.numbers(0), self.numbers(6)[:3]
        self.arm.start(ToolVelocity(velocity, float(self.numbers(12, 1)[0])))
        while not (steps := self.arm.contact_since(direction)):
            yield
        yield from self._return_to(steps)

    def _return_to(self, steps: int) -> Thread:
        """Stop, then go back to where the contact was first felt."""
        q = self.arm.history[-min(steps, len(self.arm.history))]
        yield from self._halting(3.0, linear=True)
        reference = self.arm.reference
        target = reference.kinematics.flange(q) @ reference.T_flange_tcp
        yield from self.wait_for(self.arm.start(LinearMove(target, 0.25, 1.2)))

    def _contact_detection_start(self) -> None:
        self.contact_step_back = 0
        direction = self.numbers(0)
        by_speed = float(direction.sum()) < 1e-10  # as in the script: a negative direction counts as none
        self.threads["contact"] = self._contact_thread(None if by_speed else direction[:3])

    def _contact_thread(self, direction: Array | None) -> Thread:
        def steps() -> int:
            return self.arm.contact_since(self.arm.tool_speed()[:3] if direction is None else direction)

        while steps() > 0:
            yield
        while not (found := steps()):
            yield
        self.contact_step_back = found
        self.internal_command = CONTACT_DETECTED

    def _contact_detection_stop(self) -> None:
        self.threads.pop("contact", None)
        self.write_integer(1, self.contact_step_back)

    def _back_to_contact(self) -> Thread:
        self._stop_async_move()
        return self._return_to(max(1, self.contact_step_back))


def _register_offset(text: str) -> int:
    found = re.search(r"# int register offset\n\s*(\d+)", text)
    return int(found.group(1)) if found else 0
