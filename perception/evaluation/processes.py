"""Worker processes of an evaluation, each with as many threads as it is given."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def workers(
    jobs: int, threads: int = 1, start: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
) -> ProcessPoolExecutor:
    """``jobs`` fresh processes; numerical libraries read the environment once, when a process loads them.

    :param start: called once in each process, with ``arguments``
    """
    for name in _THREADS:
        os.environ[name] = str(threads)
    return ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), start, arguments)
