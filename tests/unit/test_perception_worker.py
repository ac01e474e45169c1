"""A perception process that is killed is told of once and followed by another; the controller goes on living."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from types import SimpleNamespace

import pytest

from controller.config import load_config
from controller.faults import FaultCode, MissionFault
from controller.looking import Looking
from controller.perception_worker import PerceptionError, PerceptionWorker
from perception.geometry import Pose
from perception.scan import Cloud


class Quick(PerceptionWorker):
    """Prepares nothing but its process."""

    def _started(self) -> tuple[ProcessPoolExecutor, Future[int]]:  # type: ignore[override]
        pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        return pool, pool.submit(os.getpid)


@pytest.fixture
def worker() -> Iterator[Quick]:
    one = Quick("ccs2")
    yield one
    one.close()


def test_a_killed_process_is_told_of_and_followed_by_another(worker: Quick) -> None:
    first = worker._submit(os.getpid).result(60.0)
    os.kill(first, signal.SIGKILL)
    told = 0
    while told < 3:
        try:
            second = worker._submit(os.getpid).result(60.0)
            break
        except (PerceptionError, BrokenProcessPool):
            told += 1
    assert 1 <= told <= 2, "in the question that was under way, and perhaps in the next one"
    assert second != first


def test_after_closing_no_other_process_is_started(worker: Quick) -> None:
    pool = worker._pool
    worker.close()
    worker._replace(pool)
    assert worker._pool is pool


def test_a_process_that_was_gone_before_it_was_asked_is_the_missions_fault_and_no_defect() -> None:
    def gone(*_: object) -> Future[None]:
        raise PerceptionError("the perception process had ended")

    cell = SimpleNamespace(locator=SimpleNamespace(submit=gone), supervisor=None, T_base_port=Pose.identity())
    looking = Looking(cell, load_config())  # type: ignore[arg-type]
    with pytest.raises(MissionFault) as caught:
        looking._ask([Cloud.__new__(Cloud)])
    assert caught.value.fault.code is FaultCode.PERCEPTION_FAILED
