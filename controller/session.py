"""One mission from configuration to evidence: open the devices, run it, close everything, write the report.

Dry run and the bench's docking come through here; daemon, soak and campaign use its parts.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Protocol

import numpy as np

from controller.assembly import assemble
from controller.calibrations.dock_log import append_dock, drift_warnings, rest_offset
from controller.calibrations.in_force import basis_of
from controller.cell import Cell
from controller.config import SiteConfig, as_yaml
from controller.durable import INSERTION_NAME
from controller.faults import Outcome
from controller.insertion import Insertion
from controller.looking import Looking
from controller.mission import Mission
from controller.perception_worker import PreparedModel
from controller.precision import refuse_too_coarse
from controller.recording.candump import candump_text
from controller.recording.log import log_into
from controller.recording.recorder import Recorder
from controller.recording.ring import CHARGER_LOSS_NAME, prune
from controller.summary import ContactSummary, LocateSummary, MissionSummary
from controller.task import Goal, Progress
from drivers.base import CanFrame, MonotonicClock
from perception.calibration.drift import Dock
from perception.errors import PortdockError
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud

log = logging.getLogger(__name__)

RECORDING_NAME = "mission.mcap"
REPORT_NAME = "report.html"
"""The last seconds of CAN traffic before the charger fell silent: `portdock charger monitor --file` reads it."""


class Display(Protocol):
    """Who shows a mission while it runs."""

    def state(self, name: str, elapsed_s: float) -> None: ...
    def progress(self, label: str, fraction: float, detail: str) -> None: ...


@dataclass(slots=True)
class MissionWatcher:
    """Hands what happens to the recorder and the display, and keeps the times of the states."""

    recorder: Recorder
    display: Display
    passed: list[tuple[str, float]] = field(default_factory=list)
    """(state, mission time of its entry)."""
    ended_s: float = 0.0
    attempts: int = 0

    def began(self, goal: Goal) -> None:
        """The recording began with the process."""

    def ended(self, outcome: Outcome, job: Progress) -> None:
        """The recording is closed with the process."""

    def transition(self, source: str, event: str, target: str, time_s: float) -> None:
        self.passed.append((target, time_s))
        self.recorder.transition(source, event, target, time_s)
        self.display.state(target, time_s - self.passed[0][1])

    def progress(self, label: str, fraction: float, detail: str) -> None:
        self.display.progress(label, fraction, detail)

    def scan(self, cloud: Cloud) -> None:
        self.recorder.scan(cloud)

    def estimate(self, estimate: PortEstimate) -> None:
        self.recorder.estimate(estimate)

    def insertion(self, insertion: Insertion) -> None:
        self.attempts += 1
        self.recorder.contact(self.attempts, contact_summary(insertion))

    def durations(self, end_s: float) -> tuple[tuple[str, float], ...]:
        """(state, seconds spent in it) in the order passed."""
        ends = [time_s for _, time_s in self.passed[1:]] + [end_s]
        return tuple((name, end - begin) for (name, begin), end in zip(self.passed, ends, strict=True))


def run_session(
    config: SiteConfig,
    folder: Path,
    display: Display,
    *,
    pace: float = 1.0,
    heartbeat_mode: int = 2,
    truth: Pose | None = None,
    notes: Sequence[tuple[str, str]] = (),
) -> MissionSummary:
    """Run one docking mission and leave recording and report in ``folder``.

    :param truth: ``T_base_port`` where it is known (dry run), for the error of the located pose.
    :param notes: further (name, text) for the recording's metadata.
    :raises LinkOpenError: a device cannot be opened; ConfigError and the like before anything is opened.
    """
    refuse_too_coarse(config)
    with ExitStack() as closing:
        recorder = Recorder(folder / RECORDING_NAME, MonotonicClock())
        try:
            live = assemble(config, recorder, closing, pace=pace, heartbeat_mode=heartbeat_mode)
        except PortdockError:
            recorder.close()
            recorder.path.unlink(missing_ok=True)  # nothing has happened yet that evidence could be of
            with suppress(OSError):
                folder.rmdir()
            raise
        attach_context(recorder, config, live.model, dict(notes))
        closing.enter_context(log_into(recorder))
        watcher = MissionWatcher(recorder, display)
        record_looks(live.cell, recorder)
        look = lambda: Looking(live.cell, config, live.coarse)  # noqa: E731
        mission = Mission(live.cell, config, live.T_port_tcp_mated, watcher, folder, look)
        mission.run()
        summary = summary_of(mission.now, watcher.durations(live.cell.clock.now_s()), truth, folder, config)
        close_recording(recorder, live.cell, summary)
    prune(Path(config.recording.folder), int(config.recording.keep_mb * 1e6), keep=folder / RECORDING_NAME)
    return with_report(summary, folder)


class Looks(Protocol):
    """What a recorder offers for a replay: where the mission stopped waiting, what a sweep was made of."""

    def waited(self, time_s: float) -> None: ...
    def swept(self, profiles: int, arm_first_s: float, arm_last_s: float) -> None: ...


def record_looks(cell: Cell, looks: Looks) -> None:
    """From here on the cell tells ``looks``."""
    cell.supervisor.on_waited = looks.waited
    cell.on_sweep = looks.swept


def log_dock(config: SiteConfig, job: Progress) -> tuple[str, ...]:
    """A dock that succeeded goes into the drift log; what the chart says then."""
    docked = job.outcome is not None and job.outcome.kind in ("charged", "charging")  # of a cycle, of the daemon's dock
    if job.T_base_tcp_mated is None or job.plan is None or not docked:
        return ()
    plan, folder = job.plan, Path(config.calibration.folder)
    if config.arm.host.startswith("127.") and not folder.exists():
        return ()  # a dry run leaves a chart only where somebody has calibrated
    offset = rest_offset(plan.T_base_port, plan.T_port_tcp_mated, job.T_base_tcp_mated)
    basis = basis_of(config)
    append_dock(folder, basis, Dock(Path(config.port.model).stem, offset))
    found = drift_warnings(folder, basis)
    for warning in found:
        log.warning("%s", warning)
    return found


def close_recording(recorder: Recorder, cell: Cell, summary: MissionSummary) -> None:
    """The last things a recording needs to know."""
    for name, health in cell.healths():
        recorder.link(name, health)
    keep_charger_loss(recorder, cell.charger.traffic_before_loss())
    recorder.close(summary)
    if recorder.failure is not None:
        log.error("the recording is not complete: %s", recorder.failure)


def keep_charger_loss(recorder: Recorder, frames: Sequence[CanFrame]) -> None:
    """The bus's traffic before the charger was lost, inside the recording and beside it, as candump writes it."""
    if not frames:
        return
    text = candump_text(frames)
    recorder.attach(CHARGER_LOSS_NAME, text.encode(), "text/plain")
    with suppress(OSError):
        recorder.path.with_name(CHARGER_LOSS_NAME).write_text(text)


def attach_context(recorder: Recorder, config: SiteConfig, model: PreparedModel, values: dict[str, str]) -> None:
    """What a reader of the recording needs to understand it without this machine."""
    recorder.attach("config.yaml", as_yaml(config).encode(), "application/yaml")
    buffer = BytesIO()
    np.savez_compressed(buffer, points=model.points.astype(np.float32))
    recorder.attach("model_points.npz", buffer.getvalue(), "application/x-npz")
    recorder.metadata("mission", values | {"model": model.checksum})
    recorder.transform("flange", "scanner", config.scanner.T_flange_scanner.pose)


def attach_insertion(recorder: Recorder, memory: Path) -> None:
    """The insertion that a daemon's job begins with, where one is stored: undocking goes back along its axis."""
    with suppress(OSError):
        recorder.attach(INSERTION_NAME, (memory / INSERTION_NAME).read_bytes(), "application/json")


def summary_of(
    job: Progress,
    states: tuple[tuple[str, float], ...],
    truth: Pose | None,
    folder: Path,
    config: SiteConfig | None = None,
) -> MissionSummary:
    """A job that is over, as the values that people read."""
    outcome, estimate, insertion = job.outcome, job.estimate, job.insertion
    assert outcome is not None, "the job is over"
    return MissionSummary(
        warnings=() if config is None else log_dock(config, job),
        outcome=outcome.kind,
        fault=None if outcome.fault is None else outcome.fault.code.value,
        remedy="" if outcome.fault is None else f"{outcome.fault}. {outcome.fault.remedy}",
        states=states,
        attempts=job.attempt,
        locate=None if estimate is None else locate_summary(estimate, truth),
        contact=None if insertion is None else contact_summary(insertion),
        recording=folder / RECORDING_NAME,
        report=folder / REPORT_NAME,
    )


def locate_summary(estimate: PortEstimate, truth: Pose | None) -> LocateSummary:
    """The estimate for people, with its error where the truth is known and a pose was given."""
    known = truth is not None and estimate.accepted
    return LocateSummary(
        accepted=estimate.accepted,
        error_mm=estimate.T_ref_port.distance_to(truth) * 1000.0 if known and truth is not None else None,
        error_deg=float(np.rad2deg(estimate.T_ref_port.angle_to(truth))) if known and truth is not None else None,
        elapsed_s=estimate.elapsed_s,
        reasons=estimate.reasons,
    )


def contact_summary(insertion: Insertion) -> ContactSummary:
    """The contact numbers of one insertion in the units of reports."""
    contact = insertion.contact
    return ContactSummary(
        along_mm=contact.along_m * 1000.0,
        lateral_mm=contact.lateral_m * 1000.0,
        roll_deg=float(np.rad2deg(contact.roll_rad)),
        tilt_deg=float(np.rad2deg(contact.tilt_rad)),
        peak_force_n=contact.peak_force_n,
    )


def with_report(summary: MissionSummary, folder: Path) -> MissionSummary:
    """A report that cannot be written costs the report, never the mission's result."""
    from controller.reports.mission import write_report  # its pictures take half a second to import

    try:
        write_report(folder / RECORDING_NAME, folder / REPORT_NAME)
    except Exception:
        log.exception("the report could not be written; the recording is complete")
        return replace(summary, report=None)
    return summary
