"""Perception in a process of its own at a lower priority: the supervisor's tick never waits for it."""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import Future, ProcessPoolExecutor

from controller.port_models import port_model
from perception.estimate import PortEstimate, Prior
from perception.locate import locate
from perception.port_model import PortModel
from perception.scan import Cloud

NICE = 5


class PerceptionWorker:
    """One worker process that keeps one port model ready."""

    def __init__(self, model: str) -> None:
        self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        self._prepared = self._pool.submit(_prepare, model)

    def checksum(self) -> str:
        """Hash of the model; waits until the worker has prepared it. Raises what the preparation raised."""
        return self._prepared.result()

    def submit(self, cloud: Cloud, prior: Prior) -> Future[PortEstimate]:
        """Locate the port in a cloud."""
        return self._pool.submit(_locate, cloud, prior)

    def close(self) -> None:
        """End the process. Idempotent."""
        self._pool.shutdown(wait=True, cancel_futures=True)


class _Kept:
    """What the worker process keeps between calls."""

    model: PortModel


def _prepare(name: str) -> str:
    os.nice(NICE)
    _Kept.model = port_model(name)
    return _Kept.model.checksum


def _locate(cloud: Cloud, prior: Prior) -> PortEstimate:
    return locate(cloud, _Kept.model, prior)
