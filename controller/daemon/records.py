"""One recording a mission, for a daemon whose links stay open: what they carry goes to the recorder of the moment.

Between two missions nothing is recorded; what the bus said last is kept for the next one. Reports are drawn by a
process of their own at a low priority.
"""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from datetime import datetime
from itertools import chain
from pathlib import Path

from controller.cell import Cell
from controller.config import SiteConfig
from controller.daemon.protocol import Event, ProgressEvent, StateEvent
from controller.faults import Outcome
from controller.insertion import Insertion
from controller.memory import give_back
from controller.perception_worker import PreparedModel
from controller.recording.log import log_into
from controller.recording.recorder import Recorder
from controller.recording.ring import prune
from controller.session import (
    RECORDING_NAME,
    REPORT_NAME,
    MissionWatcher,
    attach_context,
    attach_insertion,
    close_recording,
    record_looks,
    summary_of,
)
from controller.summary import MissionSummary
from controller.task import Goal, Progress
from drivers.base import ArmCommandRecord, ArmState, CanFrame, Direction, MonotonicClock
from perception.errors import PortdockError
from perception.estimate import PortEstimate
from perception.scan import Cloud

log = logging.getLogger(__name__)

REPORT_NICE = "15"
HEARD_FRAMES = 3
"""Of each identifier; more than one, for the first of a counter is not believed."""


class _Unseen:
    """A mission's display where nobody looks: subscribers are told by ``Recordings`` itself."""

    def state(self, name: str, elapsed_s: float) -> None: ...
    def progress(self, label: str, fraction: float, detail: str) -> None: ...


class Recordings:
    """The evidence of a daemon: ``ByteSink``, the gate's ``CommandLog`` and the mission's ``Watcher`` in one."""

    def __init__(
        self,
        config: SiteConfig,
        publish: Callable[[Event], None],
        ended: Callable[[Outcome, Progress, MissionSummary | None], None],
        reports: bool = True,
    ) -> None:
        """``ended`` gets each mission's result before its job is answered. ``reports``: draw a page a mission."""
        self._config, self._publish, self._ended, self._reports = config, publish, ended, reports
        self._recorder: Recorder | None = None
        self._watcher: MissionWatcher | None = None
        self._closing = ExitStack()
        self._cell: Cell | None = None
        self._model: PreparedModel | None = None
        self._memory = Path()
        self._bus = threading.Lock()
        self._heard: dict[int, tuple[CanFrame, ...]] = {}
        self._drawing: subprocess.Popen[bytes] | None = None
        self._begin_s = 0.0
        self.on_transition: Callable[[str, str, str], None] = lambda source, event, target: None
        """Told every transition, also those between missions."""

    def attach(self, cell: Cell, model: PreparedModel, memory: Path) -> None:
        """The live cell: known only after the sink that is handed to it. ``memory``: where an insertion is stored."""
        self._cell, self._model, self._memory = cell, model, memory
        record_looks(cell, self)

    # --- a mission's life ---------------------------------------------------------------------------------------------

    def began(self, goal: Goal) -> None:
        """A new recording. Without one the mission goes on: a full disk must not keep a plug in a port."""
        assert self._cell is not None and self._model is not None
        self._finish(None)
        self._begin_s = self._cell.clock.now_s()
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")
        folder = Path(self._config.recording.folder) / f"{stamp}-{goal.value}"
        try:
            recorder = Recorder((folder / RECORDING_NAME).resolve(), MonotonicClock())
        except (PortdockError, OSError) as error:
            log.error("this mission is not recorded: %s", error)
            return
        facts = {"goal": goal.value, "pace": f"{self._cell.time_scale:g}"}
        attach_context(recorder, self._config, self._model, facts)
        attach_insertion(recorder, self._memory)
        self._closing.enter_context(log_into(recorder))
        self._watcher = MissionWatcher(recorder, _Unseen())
        with self._bus:  # no frame is lost in between, none is there twice
            for frame in sorted(chain.from_iterable(self._heard.values()), key=lambda frame: frame.time_s):
                recorder.can_frame(frame)
            self._recorder = recorder
        self._cell.recorded_since_s = self._cell.wall.now_s()

    def ended(self, outcome: Outcome, job: Progress) -> None:
        """The recording is complete with the mission's summary."""
        summary: MissionSummary | None = None
        watcher = self._watcher
        if self._recorder is not None and watcher is not None and watcher.passed and self._cell is not None:
            states = watcher.durations(self._cell.clock.now_s())
            try:
                summary = summary_of(job, states, None, self._recorder.path.parent, self._config)
            except Exception:  # the mission goes on without one
                log.exception("%s lacks its summary", self._recorder.path)
        self._finish(summary)
        self._ended(outcome, job, summary)

    def close(self) -> None:
        """End a recording that has no end, and wait a little for the last report."""
        self._finish(None)
        if self._drawing is not None:
            try:
                self._drawing.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                self._drawing.terminate()

    def _finish(self, summary: MissionSummary | None) -> None:
        recorder, self._recorder, self._watcher = self._recorder, None, None
        if recorder is None or self._cell is None:
            return
        try:
            if summary is None:
                recorder.close()
            else:
                close_recording(recorder, self._cell, summary)
        except Exception:  # whatever it is costs the recording its end, never the mission
            log.exception("%s lacks its end", recorder.path)
        self._closing.close()
        give_back()
        try:
            self._tidy_up(recorder)
        except Exception:  # a disk that fails, a process that does not start: costs a report, never a charge
            log.exception("recordings are not tidied up, or no report is drawn")

    def _tidy_up(self, recorder: Recorder) -> None:
        recording = self._config.recording
        prune(Path(recording.folder), int(recording.keep_mb * 1e6), keep=recorder.path)
        if self._reports and recorder.failure is None:
            self._draw(recorder.path)

    def _draw(self, recording: Path) -> None:
        """The report, one at a time; a mission that ends while one is drawn has its report drawn on request."""
        if self._drawing is not None and self._drawing.poll() is None:
            log.info("no report for %s: the one before is still being drawn", recording)
            return
        command = ["nice", "-n", REPORT_NICE, sys.executable, "-m", "controller.cli.main", "recording", "report"]
        command += [str(recording), "--out", str(recording.with_name(REPORT_NAME))]
        self._drawing = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    # --- Watcher ------------------------------------------------------------------------------------------------------

    def transition(self, source: str, event: str, target: str, time_s: float) -> None:
        if self._watcher is not None:
            self._watcher.transition(source, event, target, time_s)
        self._publish(StateEvent(target, event, round(time_s - self._begin_s, 3)))
        self.on_transition(source, event, target)

    def progress(self, label: str, fraction: float, detail: str) -> None:
        if self._watcher is not None:
            self._watcher.progress(label, fraction, detail)
        self._publish(ProgressEvent(label, round(fraction, 3), detail))

    def scan(self, cloud: Cloud) -> None:
        if self._watcher is not None:
            self._watcher.scan(cloud)

    def estimate(self, estimate: PortEstimate) -> None:
        if self._watcher is not None:
            self._watcher.estimate(estimate)

    def insertion(self, insertion: Insertion) -> None:
        if self._watcher is not None:
            self._watcher.insertion(insertion)

    # --- what the links carry and the gate decides --------------------------------------------------------------------

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        if (recorder := self._recorder) is not None:
            recorder.scanner_bytes(direction, data, host_time_ns)

    def coarse_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        if (recorder := self._recorder) is not None:
            recorder.coarse_bytes(direction, data, host_time_ns)

    def can_frame(self, frame: CanFrame) -> None:
        """A recording begins with what the bus said last before it: a replay has to know what the mission knew."""
        with self._bus:
            if frame.direction == "rx" and not frame.is_error:
                before = self._heard.get(frame.arbitration_id, ())
                self._heard[frame.arbitration_id] = (*before[1 - HEARD_FRAMES :], frame)
            if (recorder := self._recorder) is not None:
                recorder.can_frame(frame)

    def arm_state(self, state: ArmState) -> None:
        if (recorder := self._recorder) is not None:
            recorder.arm_state(state)

    def arm_command(self, record: ArmCommandRecord) -> None:
        if (recorder := self._recorder) is not None:
            recorder.arm_command(record)

    def command(self, name: str, detail: str, allowed: bool, reason: str) -> None:
        if (recorder := self._recorder) is not None:
            recorder.command(name, detail, allowed, reason)

    def waited(self, time_s: float) -> None:
        if (recorder := self._recorder) is not None:
            recorder.waited(time_s)

    def swept(self, profiles: int, arm_first_s: float, arm_last_s: float) -> None:
        if (recorder := self._recorder) is not None:
            recorder.swept(profiles, arm_first_s, arm_last_s)
