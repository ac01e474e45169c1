"""One cell of the campaign: a dry run with one fault made on entry to one state, and the start after it."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from controller.assembly import assemble
from controller.campaign.findings import Findings
from controller.campaign.inject import MAKE, Scene, undo_disk
from controller.campaign.rules import STOPPING_S
from controller.campaign.watching import LivePlug
from controller.config import SiteConfig
from controller.faults import Outcome
from controller.mission import Mission
from controller.mock_cell import MockCell
from controller.port_files import load_port
from controller.recording.reader import read_recording
from controller.recording.recorder import Recorder
from controller.scenarios import draw_scenario
from controller.session import (
    RECORDING_NAME,
    MissionWatcher,
    attach_context,
    close_recording,
    record_looks,
    summary_of,
)
from controller.states import State
from controller.task import Goal
from drivers.base import ArmState, MonotonicClock
from perception.errors import PortdockError


class _Quiet:
    """Nobody looks."""

    def state(self, name: str, elapsed_s: float) -> None: ...
    def progress(self, label: str, fraction: float, detail: str) -> None: ...


class _Injector(MissionWatcher):
    """Makes the fault on the first entry to its state."""

    scene: Scene
    fault: str = ""
    at: str = ""
    made: bool = False

    def transition(self, source: str, event: str, target: str, time_s: float) -> None:
        """As a watcher; then the fault."""
        super().transition(source, event, target, time_s)
        if target == self.at and not self.made:
            self.made = True
            MAKE[self.fault](self.scene)


def run_cell(fault: str, state: State, config: SiteConfig, folder: Path, pace: float, seed: int = 0) -> Findings:
    """Run it and leave the recording in ``folder``. Raises LinkOpenError when the mocks do not come up."""
    begun_s = time.monotonic()
    world = draw_scenario("nominal", config, load_port(config.port.model), seed)
    with (
        tempfile.TemporaryDirectory(prefix="portdock-campaign-") as wires,
        MockCell(Path(wires), config, world, seed, pace) as mocks,
    ):
        outcome, made, plug, end_s = _mission(fault, state, mocks, folder, pace)
        undo_disk()
        mocks.repair()
        next_start, next_travel_m = _next_start(mocks.config, folder, pace)
    states = _samples(folder / RECORDING_NAME)
    return Findings(
        fault=fault,
        state=state.name,
        made=made,
        outcome=outcome.kind,
        code=None if outcome.fault is None else outcome.fault.code.value,
        detail="" if outcome.fault is None else outcome.fault.detail,
        drift_m=_drift_m(folder / RECORDING_NAME, states),
        live_travel_m=plug.live_travel_m,
        clear=plug.clear,
        recorded_until_s=max(0.0, end_s - states[-1].time_s) if states and fault != "arm-frozen" else 0.0,
        next_start=next_start,
        next_travel_m=next_travel_m,
        duration_s=round(time.monotonic() - begun_s, 1),
    )


def _mission(
    fault: str, state: State, mocks: MockCell, folder: Path, pace: float
) -> tuple[Outcome, bool, LivePlug, float]:
    with ExitStack() as closing:
        recorder = Recorder(folder / RECORDING_NAME, MonotonicClock())
        closing.callback(recorder.close)
        live = assemble(mocks.config, recorder, closing, pace=pace, heartbeat_mode=1)
        attach_context(recorder, mocks.config, live.model, {"fault": fault, "state": state.name, "pace": f"{pace:g}"})
        watcher = _Injector(recorder, _Quiet())
        watcher.scene = Scene(mocks, live.cell, recorder.path)
        watcher.fault, watcher.at = fault, state.name
        record_looks(live.cell, recorder)
        mission = Mission(live.cell, mocks.config, live.T_port_tcp_mated, watcher, folder)
        with LivePlug(live.cell) as plug:
            outcome = mission.run(Goal.CYCLE)
            end_s = live.cell.wall.now_s()
            live.cell.wall.sleep(2.0 * STOPPING_S)  # what the arm does after FAULT belongs to the evidence
            plug.settle(mission.task.plan)
        summary = summary_of(mission.now, watcher.durations(live.cell.clock.now_s()), None, folder)
        close_recording(recorder, live.cell, summary)
    return outcome, watcher.made, plug, end_s


def _next_start(config: SiteConfig, folder: Path, pace: float) -> tuple[str, float | None]:
    """A new start on the same cell with the same memory: what it says, and how far the arm moves meanwhile."""
    path = folder / "next-start.mcap"
    with ExitStack() as closing:
        recorder = Recorder(path, MonotonicClock())
        closing.callback(recorder.close)
        try:
            live = assemble(config, recorder, closing, pace=pace, heartbeat_mode=1)
            mission = Mission(live.cell, config, live.T_port_tcp_mated, MissionWatcher(recorder, _Quiet()), folder)
            outcome = mission.run(Goal.RESET)
        except PortdockError as error:
            return f"{error.code}: {error.cause}", None
    says = outcome.kind if outcome.fault is None else f"{outcome.kind}: {outcome.fault.code.value}"
    return says, _travel_m(_samples(path))


def _samples(path: Path) -> list[ArmState]:
    return read_recording(path).arm_states()


def _drift_m(path: Path, states: list[ArmState]) -> float | None:
    """How far the arm moved after FAULT and the time it may take to stop; None without FAULT or samples."""
    entered = [step.time_s for step in read_recording(path).transitions() if step.to_state == State.FAULT.name]
    return _travel_m([s for s in states if s.time_s > entered[0] + STOPPING_S]) if entered else None


def _travel_m(states: list[ArmState]) -> float | None:
    if not states:
        return None
    places = np.array([state.T_base_tcp.translation for state in states])
    return float(np.linalg.norm(places - places[0], axis=1).max())
