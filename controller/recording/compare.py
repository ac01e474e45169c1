"""Two recordings of what should be the same mission: the first difference in states, answers, decisions and commands.

What a replay is judged by. Times are not compared (a replay has another clock), numbers within the tolerances below.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Protocol, TypeVar

import numpy as np

from controller.commands import SetOutput
from controller.recording.values import Decision, Located, Scanned, Transition
from drivers.base import ArmCommandRecord

T = TypeVar("T")

POSITION_TOLERANCE_M = 1e-6
ANGLE_TOLERANCE_RAD = 1e-6
EDGE = SetOutput.__name__
ARGUMENT_TOLERANCE = 1e-6
"""Of an arm command's arguments, in their own SI units."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Where two missions part."""

    what: str
    """Which sequence: state, estimate, decision, arm command."""
    index: int
    expected: str
    actual: str

    def __str__(self) -> str:
        return f"{self.what} {self.index + 1}: expected {self.expected}, got {self.actual}"


class Evidence(Protocol):
    """What is compared of a mission."""

    def transitions(self) -> list[Transition]: ...
    def scans(self) -> list[Scanned]: ...
    def estimates(self) -> list[Located]: ...
    def decisions(self) -> list[Decision]: ...
    def arm_commands(self) -> list[ArmCommandRecord]: ...


def first_difference(expected: Evidence, actual: Evidence, *, cut: bool = False) -> Difference | None:
    """The first difference; states are looked at first, because everything else follows from them.

    ``cut``: neither is complete; they are compared as far as both go. A recording that was thinned of its clouds is
    compared without them.
    """
    scans = actual.scans() if expected.scans() else []
    expected_decisions, actual_decisions = (deliberate(one.decisions()) for one in (expected, actual))
    comparisons: Iterable[Difference | None] = (
        _compare("state", expected.transitions(), actual.transitions(), _same_transition, _say_transition, cut),
        _compare("scan", expected.scans(), scans, _same_scan, _say_scan, cut),
        _compare("estimate", expected.estimates(), actual.estimates(), _same_estimate, _say_estimate, cut),
        _compare("decision", expected_decisions, actual_decisions, _same_decision, _say_decision, cut),
        _compare("arm command", expected.arm_commands(), actual.arm_commands(), _same_command, _say_command, cut),
    )
    return next((difference for difference in comparisons if difference is not None), None)


def _compare(
    what: str,
    expected: Sequence[T],
    actual: Sequence[T],
    same: Callable[[T, T], bool],
    say: Callable[[T], str],
    cut: bool,
) -> Difference | None:
    for index, (one, other) in enumerate(zip(expected, actual, strict=False) if cut else zip_longest(expected, actual)):
        if one is None or other is None or not same(one, other):
            texts = ("nothing" if value is None else say(value) for value in (one, other))
            return Difference(what, index, *texts)
    return None


def deliberate(decisions: Sequence[Decision]) -> list[Decision]:
    """Without a trigger's edges that were allowed: how many fit into a wait depends on when it is looked at."""
    return [decision for decision in decisions if decision.name != EDGE or not decision.allowed]


def _same_transition(a: Transition, b: Transition) -> bool:
    return (a.from_state, a.event, a.to_state) == (b.from_state, b.event, b.to_state)


def _say_transition(t: Transition) -> str:
    return f"{t.from_state} -> {t.to_state} ({t.event})"


def _same_scan(a: Scanned, b: Scanned) -> bool:
    one, other = a.cloud.points, b.cloud.points
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=0.0, atol=POSITION_TOLERANCE_M))


def _say_scan(scanned: Scanned) -> str:
    points = scanned.cloud.points
    middle = ", ".join(f"{v:.4f}" for v in 1e3 * points.mean(axis=0)) if len(points) else "none"
    return f"{len(points)} points around ({middle}) mm"


def _same_estimate(a: Located, b: Located) -> bool:
    one, other = a.estimate, b.estimate
    return (
        (one.port, one.accepted, one.verdict, one.ref) == (other.port, other.accepted, other.verdict, other.ref)
        and one.T_ref_port.distance_to(other.T_ref_port) <= POSITION_TOLERANCE_M
        and one.T_ref_port.angle_to(other.T_ref_port) <= ANGLE_TOLERANCE_RAD
    )


def _say_estimate(located: Located) -> str:
    e = located.estimate
    x, y, z = 1e3 * e.T_ref_port.translation
    verdict = "accepted" if e.accepted else "refused"
    return f"{e.port} {verdict} ({e.verdict}) at ({x:.4f}, {y:.4f}, {z:.4f}) mm in {e.ref}"


def _same_decision(a: Decision, b: Decision) -> bool:
    return (a.name, a.allowed) == (b.name, b.allowed)


def _say_decision(d: Decision) -> str:
    return f"{d.name} {'allowed' if d.allowed else 'refused: ' + d.reason}"


def _same_command(a: ArmCommandRecord, b: ArmCommandRecord) -> bool:
    if (a.name, a.result, len(a.arguments)) != (b.name, b.result, len(b.arguments)):
        return False
    return bool(np.allclose(a.arguments, b.arguments, rtol=0.0, atol=ARGUMENT_TOLERANCE, equal_nan=True))


def _say_command(c: ArmCommandRecord) -> str:
    arguments = ", ".join(f"{value:.6f}" for value in c.arguments)
    return f"{c.name}({arguments}) {c.result}"
