"""Reads the few things the mock understands in URScript text: calls with literal numbers and poses."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from mocks.spatial import matrix_of
from mocks.ur.motion import JointMove, LinearMove, Motion
from mocks.ur.program import ThreadedProgram
from perception.geometry import Array

_CALL = re.compile(r"^\s*(\w+)\((.*)\)\s*$")
_VECTOR = re.compile(r"(p?)\[([^\]]*)\]")
_NAMED = re.compile(r"\b(\w+)\s*=\s*([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)")
PATH_MARKER = "# inject move path\n"


@dataclass(frozen=True, slots=True, eq=False)
class Call:
    """One call: its name, a leading joint vector or pose, positional numbers after it, and named numbers."""

    name: str
    vector: Array | None
    is_pose: bool
    numbers: tuple[float, ...]
    named: tuple[tuple[str, float], ...]
    text: str

    def value(self, name: str, position: int, default: float) -> float:
        """A named or positional number."""
        for key, number in self.named:
            if key == name:
                return number
        return self.numbers[position] if position < len(self.numbers) else default

    @property
    def is_move(self) -> bool:
        """movej, movel, movep."""
        return self.name in ("movej", "movel", "movep") and self.vector is not None and len(self.vector) == 6

    def motion(self, program: ThreadedProgram) -> Motion:
        """The motion this call asks for. Raises ScriptError when its pose is out of reach."""
        vector = np.zeros(6) if self.vector is None else self.vector
        if self.name == "movej":
            q = program.joints_for(matrix_of(vector)) if self.is_pose else vector
            return JointMove(q, self.value("v", 1, 1.05), self.value("a", 0, 1.4))
        reference = program.arm.reference
        target = matrix_of(vector) if self.is_pose else reference.kinematics.flange(vector) @ reference.T_flange_tcp
        return LinearMove(target, self.value("v", 1, 0.25), self.value("a", 0, 1.2))


def parse_call(line: str) -> Call | None:
    """A line that is one call, or None. Arguments that are no plain numbers are left out."""
    found = _CALL.match(line)
    if found is None:
        return None
    name, arguments = found.groups()
    vector, is_pose, rest = None, False, arguments
    first = _VECTOR.search(arguments)
    if first is not None:
        vector = np.array(_numbers(first.group(2).split(",")))
        is_pose = first.group(1) == "p"
        rest = arguments[: first.start()] + arguments[first.end() :]
    named = tuple((key, float(value)) for key, value in _NAMED.findall(rest))
    plain = tuple(_numbers(part for part in _NAMED.sub("", rest).split(",") if part.strip()))
    return Call(name, vector, is_pose, plain, named, arguments)


def moves_in(text: str) -> list[Call]:
    """The path that ur_rtde injects into its script behind the marker: one move on each line."""
    if PATH_MARKER not in text:
        return []
    block = text.split(PATH_MARKER, 1)[1].split("end", 1)[0]
    calls = (parse_call(line) for line in block.splitlines())
    return [call for call in calls if call is not None and call.is_move]


def _numbers(parts: object) -> list[float]:
    values = []
    for part in parts:  # type: ignore[attr-defined]
        terms = [term.strip() for term in part.split("+")]
        try:
            values.append(sum(float(term) for term in terms if term))
        except ValueError:
            continue
    return values
