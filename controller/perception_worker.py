"""Perception in a process of its own at a lower priority: the supervisor's tick never waits for it."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np

from controller.port_models import port_model
from controller.worker_process import begin_worker
from perception.errors import PortdockError
from perception.estimate import PortEstimate, Prior
from perception.geometry import Array, Pose
from perception.locate import locate
from perception.port_model import PortModel
from perception.rough import RoughPlace, find_roughly
from perception.scan import Cloud
from perception.views_locate import locate_views

Value = TypeVar("Value")


class PerceptionError(PortdockError):
    """The worker process ended by itself."""

    code: ClassVar[str] = "perception"
    default_remedy: ClassVar[str] = "See the log above; check free memory and the installation (`portdock locate`)."


@dataclass(frozen=True, slots=True, eq=False)
class PreparedModel:
    """What the parent needs to know of the worker's port model."""

    checksum: str
    points: Array
    """(N, 3) sample points of the model's surface, port frame, metres."""


class PerceptionWorker:
    """One worker process that keeps one port model ready. One that was killed is followed by another.

    Whoever asks when it happens, or is the first to ask afterwards, is told; who asks next has the new one.
    """

    def __init__(self, model: str) -> None:
        self._model = model
        self._closed = False
        self._changing = threading.Lock()
        self._pool, self._prepared = self._started()

    def _started(self) -> tuple[ProcessPoolExecutor, Future[PreparedModel]]:
        pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        return pool, pool.submit(_prepare, self._model)

    def prepared(self) -> PreparedModel:
        """Waits until the worker has its model. Raises what the preparation raised, or PerceptionError."""
        try:
            return self._prepared.result()
        except BrokenProcessPool as error:
            raise PerceptionError("the perception process ended before it was ready") from error

    def submit(self, clouds: Sequence[Cloud], prior: Prior) -> Future[PortEstimate]:
        """Locate the port in one scan or in several of it, all in the frame of the prior."""
        return self._submit(_locate, tuple(clouds), prior)

    def submit_rough(self, cloud: Cloud, prior: Prior) -> Future[RoughPlace]:
        """Find the port roughly in a coarse scan, in the frame of the prior."""
        return self._submit(_find_roughly, cloud, prior)

    def _submit(self, work: Callable[..., Value], *arguments: object) -> Future[Value]:
        """Raises PerceptionError if the process is gone."""
        pool = self._pool
        try:
            future = pool.submit(work, *arguments)
        except BrokenProcessPool as error:
            self._replace(pool)
            raise PerceptionError("the perception process had ended; another one is being started") from error
        future.add_done_callback(lambda done: self._replace_if_broken(pool, done))
        return future

    def _replace_if_broken(self, pool: ProcessPoolExecutor, done: Future[Value]) -> None:
        if not done.cancelled() and isinstance(done.exception(), BrokenProcessPool):
            self._replace(pool)

    def _replace(self, broken: ProcessPoolExecutor) -> None:
        """From any thread; the first to see it starts the new process."""
        with self._changing:
            if self._pool is broken and not self._closed:
                self._pool, self._prepared = self._started()

    def close(self) -> None:
        """End the process. Idempotent."""
        with self._changing:
            self._closed = True
        self._pool.shutdown(wait=True, cancel_futures=True)


class PerceptionHere:
    """The same in this process, for a replay: nothing else waits meanwhile."""

    def __init__(self, model: str) -> None:
        """Prepares the model. Raises as ``port_model`` does."""
        _Kept.model = port_model(model)
        self.checksum = _Kept.model.checksum

    def submit(self, clouds: Sequence[Cloud], prior: Prior) -> Future[PortEstimate]:
        """Located on return."""
        return _at_once(lambda: _locate(tuple(clouds), prior))

    def submit_rough(self, cloud: Cloud, prior: Prior) -> Future[RoughPlace]:
        """Found on return."""
        return _at_once(lambda: _find_roughly(cloud, prior))


def _at_once(work: Callable[[], Value]) -> Future[Value]:
    future: Future[Value] = Future()
    try:
        future.set_result(work())
    except Exception as error:
        future.set_exception(error)
    return future


class _Kept:
    """What the worker process keeps between calls."""

    model: PortModel


def _prepare(name: str) -> PreparedModel:
    begin_worker()
    _Kept.model = port_model(name)
    _Kept.model.make_ready()
    return PreparedModel(_Kept.model.checksum, _Kept.model.surface.points.astype(np.float64))


def _find_roughly(cloud: Cloud, prior: Prior) -> RoughPlace:
    return find_roughly(cloud, _Kept.model.surface.points.astype(np.float64), prior)


def _locate(clouds: tuple[Cloud, ...], prior: Prior) -> PortEstimate:
    """Several scans lie in one frame, as the arm says where each was taken; the newest counts as the first."""
    if len(clouds) == 1:
        return locate(clouds[0], _Kept.model, prior)
    newest_first = clouds[::-1]
    return locate_views(newest_first, _Kept.model, prior, [Pose.identity()] * len(clouds)).estimate
