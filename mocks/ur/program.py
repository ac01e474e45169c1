"""What runs on the emulated controller: programs made of cooperative threads, as URScript has them.

A thread is a generator that yields once per controller step. A program that ends, or raises ScriptError, leaves the
controller in the state STOPPED.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mocks.spatial import inverse_of
from mocks.ur.motion import Motion
from perception.geometry import Array

if TYPE_CHECKING:
    from mocks.ur.controller import Controller

Thread = Iterator[None]


class ScriptError(Exception):
    """A run-time error of the script: the program ends."""


class Program(Protocol):
    """A running program."""

    name: str

    def tick(self) -> bool:
        """One controller step; False when the program has ended. Raises ScriptError."""

    def before_inputs(self) -> None:
        """Input registers are about to be overwritten. Raises ScriptError."""


class ThreadedProgram:
    """A main thread and named threads beside it."""

    name = "program"

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.arm = controller.arm
        self.threads: dict[str, Thread] = {}
        self._main = self.main()

    def main(self) -> Thread:
        """The main thread."""
        raise NotImplementedError

    def tick(self) -> bool:
        """One step of each thread."""
        for name, thread in list(self.threads.items()):
            if next(thread, _ENDED) is _ENDED and self.threads.get(name) is thread:
                del self.threads[name]
        return next(self._main, _ENDED) is not _ENDED

    def before_inputs(self) -> None:
        """Nothing is lost by default."""

    def run(self, name: str, thread: Thread) -> None:
        """Start a thread; its first step is taken now, as nothing comes between in URScript."""
        if next(thread, _ENDED) is not _ENDED:
            self.threads[name] = thread

    def wait_for(self, motion: Motion) -> Thread:
        """Until a motion has ended."""
        while not motion.done and self.arm.motion is motion:
            yield

    def joints_for(self, T_base_tcp: Array, near: Array | None = None) -> Array:
        """Inverse kinematics with the present TCP. Raises ScriptError without a solution."""
        q = self.find_joints(T_base_tcp, near)
        if q is None:
            raise ScriptError("get_inverse_kin: no solution")
        return q

    def find_joints(self, T_base_tcp: Array, near: Array | None = None) -> Array | None:
        """Inverse kinematics with the present TCP, or None."""
        if not np.isfinite(T_base_tcp).all():
            return None
        reference = self.arm.reference
        goal = T_base_tcp @ inverse_of(reference.T_flange_tcp)
        return reference.kinematics.inverse(goal, reference.q if near is None else near)


_ENDED = object()
