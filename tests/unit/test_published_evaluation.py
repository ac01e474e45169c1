"""The evaluation: its trials, its baselines, and a runner that can be stopped and taken up again."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from controller.port_files import load_port
from perception.errors import InputError
from perception.evaluation import runner, trials
from perception.evaluation.baseline1 import SketchMacroMicroBaseline
from perception.evaluation.baseline2 import FourPointBaseline
from perception.evaluation.methods import METHODS, chosen
from perception.evaluation.metrics import common_loss
from perception.evaluation.outcomes import Problem
from perception.evaluation.peers import Open3DPeer
from perception.evaluation.records import SplitRecord, TrialRecord
from perception.evaluation.trials import (
    ALL_CONDITIONS,
    COMPLETE,
    INTEGRITIES,
    MANY_OUTLIERS,
    PARTIAL,
    SINGLE_VIEW,
    integrity_condition,
    make_target,
    make_trial,
    reference_points,
)
from perception.geometry import Pose


@pytest.fixture(scope="module")
def shape():
    return load_port("ccs2").shape


@pytest.fixture(scope="module")
def target(shape):
    return make_target(shape)


def test_a_trial_is_the_same_for_the_same_seed_and_another_for_another(shape):
    first = make_trial(shape, COMPLETE, 5, 0)
    trials._scan.cache_clear()
    again, other = make_trial(shape, COMPLETE, 5, 0), make_trial(shape, COMPLETE, 5, 1)
    np.testing.assert_array_equal(first.test, again.test)
    np.testing.assert_array_equal(first.T_target_test.matrix, again.T_target_test.matrix)
    assert not np.allclose(first.T_target_test.matrix, other.T_target_test.matrix)


def test_integrity_keeps_its_share_on_one_side(shape):
    whole = make_trial(shape, COMPLETE, 5, 0)
    for p in INTEGRITIES:
        part = make_trial(shape, integrity_condition(p), 5, 0)
        assert len(part.test) / len(whole.test) == pytest.approx(p, abs=0.005)
        kept = (whole.test[:, None, 0] == part.test[None, :, 0]).any(axis=1)
        # one straight cut: a plane parts what was kept from what is missing
        if p < 1.0:
            gone, left = whole.test[~kept], whole.test[kept]
            cut = linprog(
                np.zeros(4),
                A_ub=np.concatenate([np.c_[gone, np.ones(len(gone))], -np.c_[left, np.ones(len(left))]]),
                b_ub=np.zeros(len(whole.test)) - 1e-6,
                bounds=[(None, None)] * 4,
            )
            assert cut.success


def test_the_scan_lies_on_the_target_at_the_true_pose_but_is_not_made_of_its_points(shape, target):
    from scipy.spatial import cKDTree

    trial = make_trial(shape, COMPLETE, 5, 0)
    placed = trial.T_target_test.apply(trial.test[trial.good])
    distance = cKDTree(target).query(placed)[0]
    assert np.median(distance) < 1.5
    assert (distance > 1e-3).mean() > 0.99


@pytest.mark.parametrize("build", [
    lambda t: SketchMacroMicroBaseline(t, np.random.default_rng(0)),
    FourPointBaseline,
    lambda t: Open3DPeer(t, "ransac"),
], ids=["baseline-1", "baseline-2", "open3d"])  # fmt: skip
def test_every_baseline_recovers_five_degrees_without_noise(target, build):
    true = Pose.from_rotvec(np.deg2rad(5.0) * np.array([0.6, 0.0, 0.8]), [2.0, -1.0, 1.0])
    outcome = build(target)(Problem(true.inverse().apply(target), 6, 3))
    error = outcome[-1].T_target_test @ true.inverse()
    assert np.rad2deg(error.angle_to(Pose.identity())) < 2.0
    assert np.linalg.norm(error.translation) < 2.0
    assert len(outcome) in (1, 6)


def test_every_condition_runs_all_profiles_and_baselines_from_the_same_starts():
    local = {"literal": "literal-28", "faithful": "faithful-28", "robust-1": "robust", "b1": "b1-28"}
    for condition in ALL_CONDITIONS:
        groups = {method.name: method.group for method in chosen(condition)}
        assert {name for name, group in groups.items() if group == "one start"} == set(local)
        assert {name for name, group in groups.items() if group == "28 starts"} == set(local.values())
        global_methods = {"b2", "o3d-ransac", "o3d-ransac-icp", "o3d-fgr-icp"}
        assert {name for name, group in groups.items() if group == "global"} == global_methods
    complete = {method.name for method in chosen(COMPLETE)}
    assert complete == {method.name for method in METHODS}


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("condition", [COMPLETE, PARTIAL, MANY_OUTLIERS, SINGLE_VIEW], ids=lambda c: c.name)
def test_baseline_2_is_no_strawman(shape, target, condition):
    """Open3D's RANSAC on the same kind of features, without ICP, must not be far better than it."""
    baseline, peer, reference = (
        FourPointBaseline(target),
        Open3DPeer(target, "ransac", icp=False),
        reference_points(shape),
    )
    losses = []
    for number in range(10):
        trial = make_trial(shape, condition, 77, number)
        problem = Problem(trial.test, condition.rounds, number)
        errors = [solve(problem)[-1].T_target_test @ trial.T_target_test.inverse() for solve in (baseline, peer)]
        losses.append([common_loss(error, reference) for error in errors])
    ours, theirs = np.median(losses, axis=0)
    assert theirs > 0.5 * ours


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_results_do_not_depend_on_the_number_of_processes(shape, tmp_path):
    condition = replace(COMPLETE, rounds=2, controls=())
    plan = runner.Plan(3, 2, (condition,), (shape, shape), merges=0)
    one, two = (runner.run(plan, tmp_path / str(jobs), jobs, lambda *_: None) for jobs in (1, 2))

    def without_times(found):
        trials = [record for record in found if isinstance(record, TrialRecord)]
        return [replace(t, rounds=tuple(replace(r, ms=0.0) for r in t.rounds)) for t in trials]

    assert len(without_times(one)) == 2 * len(chosen(condition))
    assert without_times(one) == without_times(two)


@pytest.mark.slow
def test_a_stopped_run_is_taken_up_where_it_stopped(shape, tmp_path, monkeypatch):
    calls = []

    def work(task):
        calls.append(task)
        found = [
            TrialRecord(c.condition.name, task.number, m, (), (), (), *[0.5] * 6)  # what matters is that it is there
            for c in task.cells
            for m in c.methods
        ]
        if task.splits:
            found.append(SplitRecord(task.number, "std", 1, 1.0, True, True, 1.0, 1.0))
        if task.merge:
            return 1, [runner.MergeRecord(task.number, 1, "joint", 0.1, 0.1)]
        return sum(len(c.methods) for c in task.cells), found

    class Here:
        def __init__(self, *_args):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_args):
            return None

        def submit(self, function, task):
            from concurrent.futures import Future

            future = Future()
            future.set_result(work(task))
            return future

    monkeypatch.setattr(runner, "workers", Here)
    plan = runner.full_plan((shape, shape), 1, 2)
    seen = []
    first = runner.run(plan, tmp_path, 1, lambda done, total: seen.append((done, total)))
    assert seen[-1][0] == seen[-1][1]
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    all_tasks = len(calls)
    asked = [(c.condition.name, task.number, m) for task in calls for c in task.cells for m in c.methods]
    assert len(asked) == len(set(asked))
    lines = (tmp_path / runner.RESULTS).read_text().splitlines()
    (tmp_path / runner.RESULTS).write_text("\n".join(lines[: len(lines) // 2]) + "\n")
    again = runner.run(plan, tmp_path, 1, lambda *_: None)
    assert again == first
    assert 0 < len(calls) - all_tasks < all_tasks
    repeated = [(c.condition.name, task.number, m) for task in calls[all_tasks:] for c in task.cells for m in c.methods]
    kept = [record for record in map(json.loads, lines[: len(lines) // 2]) if record["kind"] == "TrialRecord"]
    assert len(repeated) == len(asked) - len(kept)  # not a method of a trial more than was lost
    more = runner.full_plan((shape, shape), 1, 3)
    assert len(runner.run(more, tmp_path, 1, lambda *_: None)) > len(first)
    with pytest.raises(InputError, match="another seed"):
        runner.run(runner.full_plan((shape, shape), 2, 2), tmp_path, 1, lambda *_: None)


def test_a_quick_plan_asks_for_three_integrities_and_few_rounds(shape):
    plan = runner.quick_plan((shape, shape), 1)
    cut = sorted({c.integrity for c in plan.conditions if c.name.startswith("integrity")})
    assert cut == [0.65, 0.80, 1.00]
    assert max(c.rounds for c in plan.conditions) <= 4
    assert plan.trials == 6
    assert len(list(itertools.chain(plan.conditions))) == len({c.name for c in plan.conditions})
