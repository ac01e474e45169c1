"""Runs the evaluation: trials spread over processes, results appended to one file, taken up again where it stopped.

Every number drawn depends on the seed and the trial alone, so neither the number of processes nor an interruption
changes a result (times apart).
"""

from __future__ import annotations

import ctypes
import json
import logging
import signal
import sys
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path

from perception.errors import InputError
from perception.evaluation import records
from perception.evaluation.merge_run import run_merge_trial
from perception.evaluation.methods import chosen, method
from perception.evaluation.processes import workers
from perception.evaluation.records import MergeRecord, Record, SplitRecord, TrialRecord
from perception.evaluation.trial_run import Bench, make_bench, run_split_control, run_trial
from perception.evaluation.trials import ALL_CONDITIONS, COMPLETE, Condition, integrity_condition
from perception.port_shape import PortShape

_log = logging.getLogger(__name__)

RESULTS = "results.jsonl"
_PLAN = "plan.json"
_PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that a process gets when its parent ends."""
_QUICK_INTEGRITIES = (1.00, 0.80, 0.65)
_QUICK_TRIALS, _QUICK_ROUNDS, _QUICK_MERGES = 6, 4, 2
Progress = Callable[[int, int], None]
"""Called with trials done and trials in all."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is run. Two runs with equal plans may share a folder."""

    seed: int
    trials: int
    conditions: tuple[Condition, ...]
    ports: tuple[PortShape, PortShape]
    """The port that the defaults were chosen on, and a second one that they never saw."""
    merges: int
    """Trials of merging views without a model."""


@dataclass(frozen=True, slots=True)
class _Cell:
    """What is run of one condition in one trial."""

    condition: Condition
    methods: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Task:
    """All that one process does in one go: the conditions that share a trial's vehicle."""

    cells: tuple[_Cell, ...]
    number: int
    seed: int
    splits: bool = False
    """The split rules too."""
    merge: bool = False
    """The merge of views without a model too."""


def full_plan(ports: tuple[PortShape, PortShape], seed: int, trials: int) -> Plan:
    """Every figure, table, control and condition."""
    return Plan(seed, trials, ALL_CONDITIONS, ports, trials)


def quick_plan(ports: tuple[PortShape, PortShape], seed: int) -> Plan:
    """Every figure and Table 1 within three minutes: few trials and rounds, three integrities, nothing beyond them."""
    conditions = tuple(
        replace(c, rounds=min(c.rounds, _QUICK_ROUNDS), controls=())
        for c in map(integrity_condition, _QUICK_INTEGRITIES)
    )
    return Plan(seed, _QUICK_TRIALS, conditions, ports, _QUICK_MERGES)


def run(plan: Plan, out: Path, jobs: int, progress: Progress) -> list[Record]:
    """Runs what is missing in ``out`` and returns every result, sorted. Raises InputError for another plan's folder."""
    out.mkdir(parents=True, exist_ok=True)
    _check_plan(plan, out / _PLAN)
    path = out / RESULTS
    tasks = list(_missing(plan, records.read(path)))
    total = sum(_weight(task) for task in _all_tasks(plan))
    done = total - sum(_weight(task) for task in tasks)
    progress(done, total)
    with workers(jobs, 1, _start_worker, (plan.ports,)) as pool:  # one core each: milliseconds are those of one core
        for future in as_completed([pool.submit(_work, task) for task in tasks]):
            finished, found = future.result()
            records.append(path, found)
            done += finished
            progress(done, total)
    return _sorted(plan, records.read(path))


def _weight(task: _Task) -> int:
    """What a task counts in the progress."""
    return sum(len(cell.methods) for cell in task.cells) + int(task.merge)


def _all_tasks(plan: Plan) -> list[_Task]:
    """Trial by trial, so that a run that is stopped early has about as many trials in every cell."""
    groups: dict[tuple[object, ...], list[_Cell]] = {}
    for condition in plan.conditions:
        same_scan = condition.noise_mm, condition.outliers, condition.single_view, condition.second_port
        cell = _Cell(condition, tuple(entry.name for entry in chosen(condition)))
        groups.setdefault(same_scan, []).append(cell)
    tasks = []
    for number in range(max(plan.trials, plan.merges)):
        for group in groups.values() if number < plan.trials else ():
            whole = COMPLETE.name in {cell.condition.name for cell in group}
            tasks.append(_Task(tuple(group), number, plan.seed, splits=whole))
        if number < plan.merges:
            tasks.append(_Task((), number, plan.seed, merge=True))
    return tasks


def _missing(plan: Plan, known: list[Record]) -> list[_Task]:
    have = {(r.condition, r.trial, r.method) for r in known if isinstance(r, TrialRecord)}
    split = {r.trial for r in known if isinstance(r, SplitRecord)}
    merged = {r.trial for r in known if isinstance(r, MergeRecord)}
    tasks = [
        replace(
            task,
            cells=_left(task, have),
            splits=task.splits and task.number not in split,
            merge=task.merge and task.number not in merged,
        )
        for task in _all_tasks(plan)
    ]
    return [task for task in tasks if task.cells or task.splits or task.merge]


def _left(task: _Task, have: set[tuple[str, int, str]]) -> tuple[_Cell, ...]:
    """The cells of a task without the methods whose result is known."""
    left = []
    for cell in task.cells:
        methods = tuple(m for m in cell.methods if (cell.condition.name, task.number, m) not in have)
        if methods:
            left.append(replace(cell, methods=methods))
    return tuple(left)


def _sorted(plan: Plan, found: list[Record]) -> list[Record]:
    """Results of this plan in an order that does not depend on which process was faster; of repeated ones the last."""
    unique: dict[tuple[str, ...], Record] = {}
    for record in found:
        unique[_key(record)] = record
    return [unique[key] for key in sorted(unique)]


def _key(record: Record) -> tuple[str, ...]:
    if isinstance(record, TrialRecord):
        return "trial", record.condition, f"{record.trial:06d}", record.method
    if isinstance(record, SplitRecord):
        return "split", f"{record.trial:06d}", record.rule
    return "merge", f"{record.trial:06d}", record.step, f"{record.view:03d}"


def _check_plan(plan: Plan, path: Path) -> None:
    names = sorted(f"{c.name}, {c.rounds} rounds" for c in plan.conditions)
    text = json.dumps({"seed": plan.seed, "conditions": names, "ports": [p.name for p in plan.ports]}, indent=1)
    if not path.exists():
        path.write_text(text + "\n", "utf-8")
    elif path.read_text("utf-8").strip() != text:
        raise InputError(
            f"{path.parent} holds the results of a run with another seed or other conditions",
            remedy="Give another --out folder, or the options of that run to take it up again.",
        )


_benches: dict[bool, Bench] = {}
"""Of this worker process: prepared once, by port."""
_ports: list[PortShape] = []


def _start_worker(ports: tuple[PortShape, PortShape]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the run itself ends its workers
    _end_with_parent()
    _ports[:] = ports
    logging.getLogger("perception.published.pipeline").setLevel(logging.ERROR)  # (18) collapses in every trial


def _end_with_parent() -> None:
    """A run that is killed outright must not leave workers behind that wait for tasks forever (Linux only)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _bench(second: bool) -> Bench:
    if second not in _benches:
        _benches[second] = make_bench(_ports[int(second)])
    return _benches[second]


def _work(task: _Task) -> tuple[int, list[Record]]:
    found: list[Record] = []
    for cell in task.cells:
        bench, methods = _bench(cell.condition.second_port), [method(name) for name in cell.methods]
        found += run_trial(bench, cell.condition, methods, task.seed, task.number)
    if task.splits:
        found += run_split_control(_bench(False), COMPLETE, task.seed, task.number)
    if task.merge:
        found += run_merge_trial(_ports[0], task.seed, task.number)
    return _weight(task), found


__all__ = ["RESULTS", "MergeRecord", "Plan", "full_plan", "quick_plan", "run"]
