"""All methods of the evaluation by name: the published method's profiles and controls, the baselines, the yardsticks.

"one start" methods begin at the given pose (baseline 1 also at its own macro pose), "28 starts" methods all try the
same 28, "global" methods need none. Within a group the starts are equal; the tables show the groups apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Literal

import numpy as np

from perception.evaluation.baseline1 import SketchMacroMicroBaseline
from perception.evaluation.baseline2 import FourPointBaseline
from perception.evaluation.outcomes import Iterate, Outcome, Problem, Solver
from perception.evaluation.peers import Open3DPeer
from perception.evaluation.trials import Condition, Controls
from perception.geometry import Array
from perception.published.feedback import FeedbackRule
from perception.published.pipeline import Registration, register
from perception.published.profiles import FAITHFUL, LITERAL, ROBUST, MethodSettings
from perception.published.target import prepare_target

Group = Literal["one start", "28 starts", "global", "control"]


@dataclass(frozen=True, slots=True)
class Method:
    """A row of the evaluation."""

    name: str
    title: str
    group: Group
    build: Callable[[Array], Solver]
    """From the target (M, 3) in mm: everything that is done once."""
    control: Controls | None = None
    """A control is run under the conditions that ask for it; None: a method, run under all."""


def published(settings: MethodSettings, *, rounds: int | None = None) -> Callable[[Array], Solver]:
    """The published method with these settings; ``rounds`` None takes as many as the problem allows."""

    def build(target: Array) -> Solver:
        prepared = prepare_target(target, settings)

        def solve(problem: Problem) -> Outcome:
            feedback = replace(settings.feedback, max_rounds=rounds or problem.rounds, stop_early=False)
            wall, cpu = perf_counter(), process_time()
            rng = np.random.default_rng(problem.seed)
            answer = register(problem.test, prepared, replace(settings, feedback=feedback), rng)
            wall, cpu = perf_counter() - wall, process_time() - cpu
            return _iterates(answer, wall, cpu / wall, settings.best_of_rounds)

        return solve

    return build


def _iterates(answer: Registration, total_s: float, load: float, best_of_rounds: bool) -> Outcome:
    """One iterate a round, with the scan as cleaned in the round returned. ``load`` turns wall into processor time."""
    preparation = total_s - sum(done.elapsed_s for done in answer.rounds)
    iterates, best = [], answer.rounds[0]
    for k, done in enumerate(answer.rounds):
        if done.score_mm2 < best.score_mm2 or not best_of_rounds:
            best = done
        elapsed = load * (done.elapsed_s + (preparation if k == 0 else 0.0))
        iterates.append(Iterate(done.T_target_test_so_far, best.kept, elapsed))
    return tuple(iterates)


def _ruled(rule: FeedbackRule, fraction: float = 0.0) -> MethodSettings:
    return replace(FAITHFUL, feedback=replace(FAITHFUL.feedback, rule=rule, jitter_fraction=fraction))


def _baseline1(*, many_starts: bool) -> Callable[[Array], Solver]:
    return lambda target: SketchMacroMicroBaseline(target, np.random.default_rng(0), many_starts=many_starts)


def _peer(engine: Literal["ransac", "fgr"], *, icp: bool = True) -> Callable[[Array], Solver]:
    return lambda target: Open3DPeer(target, engine, icp=icp)


_ROBUST_FEEDBACK = replace(ROBUST, feedback=FAITHFUL.feedback)
_XYZ = replace(LITERAL, feedback=FAITHFUL.feedback, best_of_rounds=True)

_CONTROLS: tuple[tuple[str, str, Callable[[Array], Solver], Controls], ...] = (
    ("literal-xyz", "literal keypoints, (18) as read", published(_XYZ), "others"),
    ("kappa-fixed", "faithful, kappa fixed", published(_ruled("fixed")), "feedback"),
    ("jitter-03", "faithful, kappa fixed, 3 % dropped at random", published(_ruled("jitter", 0.03)), "feedback"),
    ("jitter-10", "faithful, kappa fixed, 10 % dropped at random", published(_ruled("jitter", 0.10)), "others"),
    ("jitter-25", "faithful, kappa fixed, 25 % dropped at random", published(_ruled("jitter", 0.25)), "feedback"),
    ("no-denoising", "faithful without denoising", published(replace(FAITHFUL, denoise=False)), "feedback"),
    ("robust-keypoints", "robust, no dense step", published(replace(ROBUST, dense=False), rounds=1), "others"),
    ("robust-no-denoising", "robust, no denoising", published(replace(ROBUST, denoise=False), rounds=1), "others"),
    ("robust-feedback", "robust, three rounds with feedback", published(_ROBUST_FEEDBACK, rounds=3), "others"),
)

METHODS: tuple[Method, ...] = (
    Method("literal", "literal: as printed, (18) in mm", "one start", published(LITERAL)),
    Method("faithful", "faithful: the published method as read", "one start", published(FAITHFUL)),
    Method("robust-1", "robust, one start", "one start", published(replace(ROBUST, many_starts=False), rounds=1)),
    Method("b1", "baseline 1 (both its poses)", "one start", _baseline1(many_starts=False)),
    Method("literal-28", "literal", "28 starts", published(replace(LITERAL, many_starts=True))),
    Method("faithful-28", "faithful", "28 starts", published(replace(FAITHFUL, many_starts=True))),
    Method("robust", "robust", "28 starts", published(ROBUST, rounds=1)),
    Method("b1-28", "baseline 1", "28 starts", _baseline1(many_starts=True)),
    Method("b2", "baseline 2", "global", FourPointBaseline),
    Method("o3d-ransac", "Open3D FPFH + RANSAC, no ICP", "global", _peer("ransac", icp=False)),
    Method("o3d-ransac-icp", "Open3D FPFH + RANSAC + ICP", "global", _peer("ransac")),
    Method("o3d-fgr-icp", "Open3D FGR + ICP", "global", _peer("fgr")),
    *(Method(name, title, "control", build, which) for name, title, build, which in _CONTROLS),
)

CONTROL_ROUNDS = 5
"""Controls take at most so many registrations; they are compared with the others after as many."""


def chosen(condition: Condition) -> tuple[Method, ...]:
    """The methods that a condition runs."""
    return tuple(entry for entry in METHODS if entry.control in (None, *condition.controls))


def method(name: str) -> Method:
    """The method of this name. Raises KeyError for another."""
    return {entry.name: entry for entry in METHODS}[name]
