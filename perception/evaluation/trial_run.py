"""One trial: its scan, every method on it, and what that is worth. Everything a worker process does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from perception.evaluation.methods import CONTROL_ROUNDS, Method
from perception.evaluation.metrics import Occupancy, angle_deg, centre_error_mm, common_loss
from perception.evaluation.outcomes import Iterate, Outcome, Problem, Solver
from perception.evaluation.records import RoundRecord, SplitRecord, TrialRecord
from perception.evaluation.trials import Condition, Trial, make_target, make_trial, port_centre, reference_points
from perception.geometry import Array, Pose
from perception.port_shape import PortShape
from perception.published.clouds import spacing
from perception.published.denoise import keep_mask, noise_statistics
from perception.published.kdtree import AdaptiveKDTree
from perception.published.kdtree_numpy import SplitRule

_VOXEL_SPACINGS = (2.0, 3.0, 5.0)
_RULES: tuple[SplitRule, ...] = ("std", "cycle", "extent")
_NOMINAL_SPACING_MM = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """One port's target with the methods prepared for it: each when it is first asked for, once for a process."""

    shape: PortShape
    target: Array
    reference: Array
    centre: Array
    _solvers: dict[str, Solver] = field(default_factory=dict)

    def solver(self, method: Method) -> Solver:
        """The method, prepared for the target."""
        if method.name not in self._solvers:
            self._solvers[method.name] = method.build(self.target)
        return self._solvers[method.name]


def make_bench(shape: PortShape) -> Bench:
    """Prepares the target."""
    return Bench(shape, make_target(shape), reference_points(shape), port_centre(shape))


def run_trial(
    bench: Bench, condition: Condition, methods: Sequence[Method], seed: int, number: int
) -> list[TrialRecord]:
    """These methods on one scan. What a method answers does not depend on which others are run."""
    trial = make_trial(bench.shape, condition, seed, number)
    own_seed = int(np.random.default_rng([seed, number, 3]).integers(2**31))
    found = []
    for method in methods:
        rounds = min(condition.rounds, CONTROL_ROUNDS) if method.group == "control" else condition.rounds
        outcome = bench.solver(method)(Problem(trial.test, rounds, own_seed))
        found.append(_judged(bench, condition, number, method, outcome, trial))
    return found


def _judged(
    bench: Bench, condition: Condition, number: int, method: Method, outcome: Outcome, trial: Trial
) -> TrialRecord:
    fine, middle, coarse = (Occupancy(bench.target, v * _NOMINAL_SPACING_MM) for v in _VOXEL_SPACINGS)
    rounds = tuple(_round_record(bench, iterate, trial, middle) for iterate in outcome)
    last, truth = outcome[-1], trial.T_target_test
    kept = trial.test if last.kept is None else trial.test[last.kept]
    estimated, true = last.T_target_test.apply(trial.test), truth.apply(trial.test)
    return TrialRecord(
        condition=condition.name,
        trial=number,
        method=method.name,
        rounds=rounds,
        rotation_error=tuple((last.T_target_test.rotation - truth.rotation).ravel().tolist()),
        translation_error_mm=tuple((last.T_target_test.translation - truth.translation).tolist()),
        ceiling_raw=middle.iou(true),
        ceiling_clean=middle.iou(truth.apply(kept)),
        iou_fine=fine.iou(estimated),
        ceiling_fine=fine.iou(true),
        iou_coarse=coarse.iou(estimated),
        ceiling_coarse=coarse.iou(true),
    )


def _round_record(bench: Bench, iterate: Iterate, trial: Trial, occupancy: Occupancy) -> RoundRecord:
    error: Pose = iterate.T_target_test @ trial.T_target_test.inverse()
    raw = occupancy.iou(iterate.T_target_test.apply(trial.test))
    clean = raw if iterate.kept is None else occupancy.iou(iterate.T_target_test.apply(trial.test[iterate.kept]))
    return RoundRecord(
        loss_mm2=common_loss(error, bench.reference),
        angle_deg=angle_deg(error),
        centre_mm=centre_error_mm(error, bench.centre),
        iou_raw=raw,
        iou_clean=clean,
        ms=1e3 * iterate.elapsed_s,
    )


def run_split_control(bench: Bench, condition: Condition, seed: int, number: int) -> list[SplitRecord]:
    """The three split rules on one scan: what they change (time) and what they cannot (anything else)."""
    points = make_trial(bench.shape, condition, seed, number).test
    radius = 4.0 * spacing(AdaptiveKDTree(points), points)
    found = []
    expected = None
    for rule in _RULES:
        begun = perf_counter()
        tree = AdaptiveKDTree(points, split=rule)
        built = perf_counter()
        statistics = noise_statistics(tree, radius)
        done = perf_counter()
        masks = [keep_mask(statistics, kappa) for kappa in (3.0, 2.0, 1.5, 1.0)]
        expected = expected or (statistics.neighbours, masks)
        visited, queries = tree.stats.nodes_visited, tree.stats.queries
        tree.query_radius(points, radius)
        visits = (tree.stats.nodes_visited - visited) / (tree.stats.queries - queries)
        same_masks = all(np.array_equal(a, b) for a, b in zip(masks, expected[1], strict=True))
        found.append(
            SplitRecord(
                number,
                rule,
                tree.stats.depth,
                visits,
                bool(np.array_equal(statistics.neighbours, expected[0])),
                same_masks,
                1e3 * (built - begun),
                1e3 * (done - built),
            )
        )
    return found
