"""Long sums in a process of their own, at a lower priority: the supervisor's tick goes on meanwhile."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import ParamSpec, TypeVar

from controller.cell import Cell
from controller.worker_process import begin_worker

P = ParamSpec("P")
R = TypeVar("R")


class Thinker:
    """One worker process."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=begin_worker)

    def ask(self, cell: Cell, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """The function's result, or what it raises. Faults of the cell end the wait."""
        future = self._pool.submit(function, *args, **kwargs)
        cell.supervisor.wait(future.done)
        return future.result()

    def close(self) -> None:
        """End the process. Idempotent."""
        self._pool.shutdown(wait=True, cancel_futures=True)
