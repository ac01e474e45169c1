"""Worker processes of an evaluation, each with as many threads as it is given."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def workers(
    jobs: int, threads: int = 1, start: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
) -> Iterator[ProcessPoolExecutor]:
    """``jobs`` fresh processes; numerical libraries read the environment once, when a process loads them.

    An error inside ends what runs and drops what waits: a long evaluation says at once what went wrong.

    :param start: called once in each process, with ``arguments``
    """
    for name in _THREADS:
        os.environ[name] = str(threads)
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), start, arguments)
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise
