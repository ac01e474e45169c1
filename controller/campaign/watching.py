"""Watches plug and power during a cell of the campaign: was the plug moved under power, did the arm end clear."""

from __future__ import annotations

import threading
from types import TracebackType

import numpy as np

from controller.cell import Cell
from controller.planning import DockPlan
from controller.states import State

PERIOD_S = 0.02
CLEAR_OF_PORT_M = 0.005


class LivePlug:
    """Samples the drivers' newest values in a thread of its own."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="live-plug", daemon=True)
        self.live_travel_m = 0.0
        self.clear: bool | None = None

    def __enter__(self) -> LivePlug:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join(timeout=2.0)

    def settle(self, plan: DockPlan | None) -> None:
        """Look where the arm ended; without a plan it never came near the vehicle, or is out again."""
        state = self._cell.arm_state()
        if state is not None:
            self.clear = plan is None or plan.depth_m(state.T_base_tcp) < -CLEAR_OF_PORT_M

    def _run(self) -> None:
        live_at: np.ndarray[tuple[int], np.dtype[np.float64]] | None = None
        while not self._ended.wait(PERIOD_S):
            arm, charger = self._cell.arm_state(), self._cell.charger_status()
            if arm is None or charger is None or not charger.contactor_closed:
                live_at = None
                continue
            if self._cell.supervisor.facts.state is State.VERIFYING:
                continue
            here = np.asarray(arm.T_base_tcp.translation, np.float64)
            live_at = here if live_at is None else live_at
            self.live_travel_m = max(self.live_travel_m, float(np.linalg.norm(here - live_at)))
