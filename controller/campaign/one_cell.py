"""One cell of the campaign: a dry run with one fault made on entry to one state, and the start after it."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller.assembly import assemble
from controller.campaign.faulty_cell import FaultyCell
from controller.campaign.findings import Findings
from controller.campaign.inject import MAKE, Scene, undo_disk
from controller.campaign.killed import drift_after_death_m, run_to_its_death
from controller.campaign.rules import KILLED, STOPPING_S
from controller.campaign.watching import LivePlug
from controller.config import SiteConfig
from controller.faults import Fault
from controller.mission import Mission
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
    with tempfile.TemporaryDirectory(prefix="portdock-campaign-") as wires, ExitStack() as closing:
        mocks = FaultyCell(Path(wires), config, world, seed, pace)
        closing.enter_context(mocks)
        run = _killed if fault == "process-killed" else _mission
        end = run(fault, state, mocks, folder, pace)
        undo_disk()
        mocks.repair()
        next_start, next_travel_m = _next_start(mocks.config, folder, pace)
    recording = folder / RECORDING_NAME
    return Findings(
        fault=fault,
        state=state.name,
        made=end.made,
        outcome=end.outcome,
        code=None if end.fault is None else end.fault.code.value,
        detail="" if end.fault is None else end.fault.detail,
        drift_m=_drift_m(recording, _samples(recording)) if end.drift_m is None else end.drift_m,
        live_travel_m=end.live_travel_m,
        clear=end.clear,
        recorded_until_s=max(0.0, end.time_s - _last_s(recording)),
        next_start=next_start,
        next_travel_m=next_travel_m,
        duration_s=round(time.monotonic() - begun_s, 1),
    )


@dataclass(frozen=True, slots=True)
class _End:
    """How the mission with the fault ended."""

    made: bool
    outcome: str
    fault: Fault | None
    time_s: float
    """Host time."""
    live_travel_m: float = 0.0
    clear: bool | None = None
    drift_m: float | None = None
    """Asked of the mock; None: as the recording has it."""


def _killed(fault: str, state: State, mocks: FaultyCell, folder: Path, pace: float) -> _End:
    killed, gone_s = run_to_its_death(lambda: _mission(fault, state, mocks, folder, pace))
    drift_m = drift_after_death_m(mocks, 1.0 / mocks.config.arm.watchdog_hz)
    return _End(killed, KILLED if killed else "ended", None, gone_s, drift_m=drift_m)


def _mission(fault: str, state: State, mocks: FaultyCell, folder: Path, pace: float) -> _End:
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
    return _End(watcher.made, outcome.kind, outcome.fault, end_s, plug.live_travel_m, plug.clear)


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


def _last_s(path: Path) -> float:
    """Host time of the last readable record of what comes by itself, or transition: a link that is lost gives none."""
    recording = read_recording(path)
    times = [state.time_s for state in recording.arm_states()] + [frame.time_s for frame in recording.can_frames()]
    return max(times + [step.time_s for step in recording.transitions()], default=0.0)


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
