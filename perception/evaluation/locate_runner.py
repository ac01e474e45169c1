"""Runs the locator's evaluation: cases spread over processes, answers appended to one file, taken up again where it
stopped. Poses depend on seed and case alone; times depend on the machine.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Mapping
from concurrent.futures import as_completed
from dataclasses import dataclass, field
from pathlib import Path

from perception.errors import InputError
from perception.evaluation import locate_records as records
from perception.evaluation.families import drawn_mesh
from perception.evaluation.locate_cases import Case, CaseScan, make_scan, seed_set
from perception.evaluation.locate_folder import FolderCase, read_scan
from perception.evaluation.locate_records import CaseRecord, error_of
from perception.evaluation.locate_solvers import AUTO, NO_PRIOR, PORTDOCK, Answer, Solver, solver
from perception.evaluation.locate_unit import prepared, timed
from perception.evaluation.processes import workers
from perception.mesh_io import read_mesh
from perception.port_model import PortModel
from perception.port_shape import PortShape

RESULTS, PLAN = "results.jsonl", "plan.json"
Progress = Callable[[int, int], None]
"""Called with cases done and cases in all."""


@dataclass(frozen=True, slots=True)
class LocatePlan:
    """What is run."""

    seed: int
    cases: tuple[Case, ...]
    shapes: Mapping[str, PortShape]
    """All ports that scans are made of and models are searched for, by name."""
    folder: tuple[FolderCase, ...] = ()
    """Scans that are read instead of made."""
    peers: tuple[str, ...] = ()
    peer_scans: int = 40
    """Peers are run on the first so many positive scans."""
    extras: tuple[str, ...] = ()
    """``no-prior``, ``auto`` and variants with published steps, beside the usual call."""

    @property
    def all_cases(self) -> tuple[Case, ...]:
        """Those made and those read."""
        return (*self.cases, *(entry.case for entry in self.folder))

    def solvers_for(self, case: Case) -> tuple[str, ...]:
        """Who is asked about a case: peers about few, as they are slow; no-prior about nominal positive scans, variants
        of the locator about positive ones."""
        asked = {NO_PRIOR: case.positive and case.tier == "nominal", AUTO: True}
        extras = [name for name in self.extras if asked.get(name, case.positive)]
        peers = self.peers if case.kind == "port" and case.number < self.peer_scans else ()
        return (PORTDOCK, *extras, *peers)


@dataclass(frozen=True, slots=True)
class _Task:
    case: Case
    solvers: tuple[str, ...]
    folder: FolderCase | None


def run(plan: LocatePlan, out: Path, jobs: int, progress: Progress) -> list[CaseRecord]:
    """Runs what is missing in ``out`` and returns every answer of the plan. Raises InputError for another's folder."""
    out.mkdir(parents=True, exist_ok=True)
    _check_plan(plan, out / PLAN)
    path = out / RESULTS
    tasks = _missing(plan, records.read(path))
    done, total = len(plan.all_cases) - len(tasks), len(plan.all_cases)
    progress(done, total)
    threads = max(1, (os.cpu_count() or 1) // jobs)
    # Both sides of every ratio of times have as many threads.
    with workers(jobs, threads, _start_worker, (plan.seed, dict(plan.shapes), threads)) as pool:
        for future in as_completed([pool.submit(_work, task) for task in tasks]):
            records.append(path, future.result())
            done += 1
            progress(done, total)
    return _chosen(plan, records.read(path))


def _missing(plan: LocatePlan, known: list[CaseRecord]) -> list[_Task]:
    have = {(record.case, record.solver) for record in known}
    entries = {entry.case.name: entry for entry in plan.folder}
    tasks = []
    for case in plan.all_cases:
        solvers = tuple(name for name in plan.solvers_for(case) if (case.name, name) not in have)
        if solvers:
            tasks.append(_Task(case, solvers, entries.get(case.name)))
    return sorted(tasks, key=lambda task: task.case.number)  # a run that is stopped early has some of every kind


def _chosen(plan: LocatePlan, found: list[CaseRecord]) -> list[CaseRecord]:
    """The plan's own answers in its order; of repeated ones the last."""
    by_key = {(record.case, record.solver): record for record in found}
    keys = [(case.name, name) for case in plan.all_cases for name in plan.solvers_for(case)]
    return [by_key[key] for key in keys if key in by_key]


def _check_plan(plan: LocatePlan, path: Path) -> None:
    """More scans, tiers or solvers may be added to a folder; another seed or other scans may not."""
    source = str(plan.folder[0].scan.parent) if plan.folder else "simulated"
    text = json.dumps({"seed": plan.seed, "set": seed_set(plan.seed), "scans": source, "ports": sorted(plan.shapes)})
    if not path.exists():
        path.write_text(text + "\n", "utf-8")
    elif path.read_text("utf-8").strip() != text:
        raise InputError(
            f"{path.parent} holds the results of a run with another seed, other ports or other scans",
            remedy="Give another --out folder, or the options of that run to take it up again.",
        )


@dataclass(slots=True)
class _Worker:
    """What a worker process keeps between cases."""

    seed: int
    shapes: dict[str, PortShape]
    threads: int
    solvers: dict[str, Solver] = field(default_factory=dict)
    models: dict[tuple[str, Path | None], PortModel] = field(default_factory=dict)
    """By name and, where a folder brings its own CAD, by file."""
    warm: set[tuple[str, str]] = field(default_factory=set)


_worker: list[_Worker] = []


def _start_worker(seed: int, shapes: dict[str, PortShape], threads: int) -> None:
    logging.getLogger("perception").setLevel(logging.ERROR)
    _worker[:] = [_Worker(seed, shapes, threads)]


def _work(task: _Task) -> list[CaseRecord]:
    (worker,) = _worker
    if task.folder is None:
        scan = make_scan(task.case, worker.seed, worker.shapes)
    else:
        scan = read_scan(task.folder)
    models = _models(worker, task)
    _, unit = timed(lambda: prepared(scan, models[task.case.asked]))
    found = []
    for name in task.solvers:
        ask = worker.solvers.setdefault(name, solver(name, worker.threads))
        if (name, task.case.asked) not in worker.warm:  # what is prepared once for a model is no part of a scan's time
            ask(scan, task.case.asked, models)
            worker.warm.add((name, task.case.asked))
        answer, times = timed(lambda ask=ask: ask(scan, task.case.asked, models))  # type: ignore[misc]
        found.append(_record(task.case, name, scan, answer, times.wall_s, times.cpu_s, unit.wall_s, unit.cpu_s))
    return found


def _models(worker: _Worker, task: _Task) -> dict[str, PortModel]:
    """The models that the task's solvers need; of the port asked for, the folder's own CAD if it brings one."""
    names = sorted({*worker.shapes, task.case.asked}) if AUTO in task.solvers else [task.case.asked]
    mesh = None if task.folder is None else task.folder.mesh
    return {name: _model(worker, name, mesh if name == task.case.asked else None) for name in names}


def _model(worker: _Worker, name: str, mesh: Path | None) -> PortModel:
    if (name, mesh) not in worker.models:
        vertices, faces = drawn_mesh(worker.shapes[name]) if mesh is None else read_mesh(mesh)
        worker.models[name, mesh] = PortModel.from_mesh(name, vertices, faces)
    return worker.models[name, mesh]


def _record(
    case: Case,
    name: str,
    scan: CaseScan,
    answer: Answer,
    wall_s: float,
    cpu_s: float,
    unit_wall_s: float,
    unit_cpu_s: float,
) -> CaseRecord:
    truth = scan.T_scanner_port
    return CaseRecord(
        case=case.name,
        kind=case.kind,
        tier=case.tier,
        port=case.port,
        asked=case.asked,
        solver=name,
        points=len(scan.cloud),
        integrity=scan.integrity,
        accepted=answer.accepted,
        verdict=answer.verdict,
        named=answer.named,
        reasons=answer.reasons,
        error=() if truth is None else error_of(answer.T_scanner_port, truth),
        covariance=() if answer.covariance is None else tuple(float(v) for v in answer.covariance.ravel()),
        bound_m=scan.bound_m,
        bound_rad=scan.bound_rad,
        wall_s=wall_s,
        cpu_s=cpu_s,
        unit_wall_s=unit_wall_s,
        unit_cpu_s=unit_cpu_s,
    )
