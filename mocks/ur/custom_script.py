"""Simple scripts sent to the script port: straight sequences of calls with literal arguments.

Not understood, and skipped with a log entry: control flow, variables, threads, sockets, functions of the script's own.
"""

from __future__ import annotations

import logging
import re
from typing import TYPE_CHECKING

import numpy as np

from mocks.spatial import matrix_of
from mocks.ur.motion import Halt, JointVelocity, ToolVelocity
from mocks.ur.program import Thread, ThreadedProgram
from mocks.ur.script_text import Call, parse_call
from mocks.ur.state import REGISTERS
from perception.geometry import Array

if TYPE_CHECKING:
    from mocks.ur.controller import Controller

log = logging.getLogger(__name__)


class CustomScript(ThreadedProgram):
    """One run of such a script."""

    def __init__(self, controller: Controller, text: str) -> None:
        super().__init__(controller)
        head = re.search(r"^\s*(?:def|sec)\s+(\w+)\s*\(", text, re.MULTILINE)
        self.name = head.group(1) if head else "script"
        self._lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]

    def main(self) -> Thread:
        for line in self._lines:
            call = parse_call(line)
            if call is None:
                if not re.match(r"\s*(def|sec)\b|\s*end\s*$", line):
                    log.warning("line of script not simulated: %s", line.strip())
                continue
            yield from self._run(call)

    def _run(self, call: Call) -> Thread:
        if call.is_move:
            yield from self.wait_for(self.arm.start(call.motion(self)))
        elif call.name in ("speedl", "speedj") and _has(call, 6):
            kind = ToolVelocity if call.name == "speedl" else JointVelocity
            self.arm.start(kind(_vector(call), call.value("a", 0, 0.5)))
            yield from self._sleep(call.value("t", 1, 0.0))
        elif call.name in ("stopj", "stopl"):
            deceleration = call.value("a", 0, 2.0)
            yield from self.wait_for(self.arm.start(Halt(deceleration, linear=call.name == "stopl")))
        elif call.name == "sleep":
            yield from self._sleep(call.value("t", 0, 0.0))
        elif call.name == "sync":
            yield
        else:
            self._set(call)

    def _sleep(self, seconds: float) -> Thread:
        end = self.controller.time_s + seconds
        while self.controller.time_s < end:
            yield

    def _set(self, call: Call) -> None:
        registers, io = self.controller.registers, self.controller.io
        vector = _vector(call)
        words = [word.strip() for word in call.text.split(",")]
        if call.name == "set_tcp" and _has(call, 6):
            self.arm.set_tcp(matrix_of(vector))
        elif call.name == "set_payload" and call.numbers:
            self.controller.payload.mass_kg = call.numbers[0]
            if _has(call, 3):
                self.controller.payload.cog = vector
        elif call.name == "write_output_integer_register" and _is_register(call):
            registers.out_int[int(call.numbers[0])] = int(max(-(2.0**31), min(2.0**31 - 1, call.numbers[1])))
        elif call.name == "write_output_float_register" and _is_register(call):
            registers.out_double[int(call.numbers[0])] = call.numbers[1]
        elif (
            call.name in ("set_digital_out", "set_standard_digital_out") and call.numbers and 0 <= call.numbers[0] < 18
        ):
            bit = 1 << int(call.numbers[0])
            io.digital_out = io.digital_out | bit if words[-1] in ("True", "1") else io.digital_out & ~bit
        elif call.name == "zero_ftsensor":
            self.arm.sensor.zero()
        elif call.name == "protective_stop":
            self.controller.protective_stop()
        else:
            log.warning("call in script not simulated: %s", call.name)


def _vector(call: Call) -> Array:
    return np.zeros(0) if call.vector is None else call.vector


def _has(call: Call, count: int) -> bool:
    return len(_vector(call)) == count


def _is_register(call: Call) -> bool:
    return len(call.numbers) == 2 and 0 <= call.numbers[0] < REGISTERS
