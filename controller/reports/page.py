"""The report's words and numbers: from a recording to the values that the template prints, all formatted here."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime

import yaml

from controller.recording import schemas
from controller.recording.reader import Recording
from controller.recording.values import Contacted, Decision, LinkReport, Located
from controller.reports.facts import Alignment, StateSpan, place_of, sigma, start_time_s
from controller.summary import MissionSummary

GREEN, AMBER, RED, GREY = "#26734d", "#b26a00", "#b3372b", "#56616d"
# outcome -> headline, what it means, colour
_VERDICTS = {
    "charged": ("Charged", "The vehicle was docked, charged and released.", GREEN),
    "refused": ("Refused", "No estimate of the port was accepted; the plug never came near the vehicle.", AMBER),
    "intervention-needed": ("Intervention needed", "The attempts are used up; a person has to look.", RED),
    "fault": ("Fault", "The mission ended in a latched fault; outputs were made safe.", RED),
    "stopped": ("Stopped", "The mission was stopped on request.", GREY),
}
_UNFINISHED = ("Unfinished", "The recording ends before the mission does.", GREY)


@dataclass(frozen=True, slots=True)
class Tile:
    """One key number."""

    name: str
    value: str
    unit: str


@dataclass(frozen=True, slots=True)
class EstimateRow:
    """One answer of the locator."""

    at: str
    accepted: bool
    verdict: str
    rms: str
    seen: str
    margin: str
    sigma: str
    took: str
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ContactRow:
    """The contact numbers of one attempt."""

    attempt: int
    along: str
    lateral: str
    roll: str
    tilt: str
    force: str


@dataclass(frozen=True, slots=True)
class RefusalRow:
    """A command that the gate refused."""

    at: str
    name: str
    detail: str
    reason: str


@dataclass(frozen=True, slots=True)
class LinkRow:
    """A link's last health."""

    name: str
    up: bool
    counters: str
    detail: str


@dataclass(frozen=True, slots=True)
class TransitionRow:
    """One transition and how long the state it led to lasted."""

    at: str
    before: str
    event: str
    after: str
    stayed: str


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures as ``data:`` addresses, empty where there is nothing to draw."""

    timeline: str = ""
    aligned: str = ""
    residuals: str = ""
    force_depth: str = ""
    force_time: str = ""


@dataclass(frozen=True, slots=True)
class Page:
    """Everything the template prints."""

    headline: str
    sentence: str
    tone: str
    when: str
    port: str
    attempts: str
    duration: str
    rehearsal: str
    """Which dry run this was; empty on a real cell."""
    fault: str
    cause: str
    remedy: str
    problems: tuple[str, ...]
    tiles: tuple[Tile, ...]
    estimated_pose: str
    estimates: tuple[EstimateRow, ...]
    contacts: tuple[ContactRow, ...]
    refusals: tuple[RefusalRow, ...]
    links: tuple[LinkRow, ...]
    transitions: tuple[TransitionRow, ...]
    transitions_open: bool
    notes: tuple[str, ...]
    configuration: str
    recorded: tuple[tuple[str, str], ...]
    source: str
    pictures: Pictures = field(default_factory=Pictures)


def page_of(recording: Recording, spans: tuple[StateSpan, ...], view: Alignment | None, pictures: Pictures) -> Page:
    """Words and numbers of one mission."""
    summary, start_s = recording.summary(), start_time_s(recording)
    estimates = recording.estimates()
    headline, sentence, tone = _UNFINISHED if summary is None else _VERDICTS.get(summary.outcome, _UNFINISHED)
    configuration = recording.attachments.get("config.yaml")
    return Page(
        headline=headline,
        sentence=sentence,
        tone=tone,
        when=_when(recording),
        port=_port(recording, estimates),
        attempts=_attempts(summary),
        duration=f"{spans[-1].end_s:.1f} s" if spans else "no transition recorded",
        rehearsal=_rehearsal(recording),
        fault="" if summary is None or summary.fault is None else summary.fault,
        cause=_cause(summary, estimates),
        remedy="" if summary is None else summary.remedy.removeprefix(f"{summary.fault}: "),
        problems=_problems(recording),
        tiles=_tiles(summary, estimates),
        estimated_pose=_estimated_pose(view),
        estimates=tuple(_estimate_row(located, start_s) for located in estimates),
        contacts=tuple(_contact_row(contacted) for contacted in recording.contacts()),
        refusals=tuple(_refusal_row(d, start_s) for d in recording.decisions() if not d.allowed),
        links=tuple(_link_row(report) for report in {r.link: r for r in recording.links()}.values()),
        transitions=_transition_rows(recording, spans),
        transitions_open=summary is None or summary.outcome != "charged",
        notes=tuple(f"{n.time_s - start_s:9.3f} s  {n.level:7}  {n.text}" for n in recording.notes()),
        configuration="" if configuration is None else configuration.data.decode(errors="replace"),
        recorded=_recorded(recording),
        source=recording.path.name,
        pictures=pictures,
    )


def _when(recording: Recording) -> str:
    first = recording.raw(schemas.STATE)[:1] or [messages[0] for messages in recording.topics.values() if messages]
    times = [message.log_time_ns for message in first]
    if not times:
        return "time unknown"
    return datetime.fromtimestamp(min(times) * 1e-9, tz=UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _port(recording: Recording, estimates: list[Located]) -> str:
    """From the last estimate, else from the configuration."""
    if estimates:
        return estimates[-1].estimate.port
    attachment = recording.attachments.get("config.yaml")
    try:
        values = yaml.safe_load(attachment.data) if attachment is not None else {}
        return str(values["port"]["model"])
    except (yaml.YAMLError, KeyError, TypeError):
        return "unknown"


def _rehearsal(recording: Recording) -> str:
    mission = recording.metadata.get("mission", {})
    if "scenario" not in mission:
        return ""
    pace = mission.get("pace", "1")
    faster = (
        "" if pace == "1" else f", wires and arm {pace} times as fast (times here are those of the clock on the wall)"
    )
    return f"Dry run with mock hardware: scenario {mission['scenario']}, seed {mission.get('seed', '?')}{faster}."


def _attempts(summary: MissionSummary | None) -> str:
    if summary is None:
        return "attempts unknown"
    return "1 attempt" if summary.attempts == 1 else f"{summary.attempts} attempts"


def _cause(summary: MissionSummary | None, estimates: list[Located]) -> str:
    """For a refusal the locator's own reasons; other faults carry their cause in the log and the transitions."""
    if summary is None or summary.outcome != "refused" or not estimates:
        return ""
    return "; ".join(estimates[-1].estimate.reasons)


def _problems(recording: Recording) -> tuple[str, ...]:
    damage = tuple(f"This recording is not complete: {text}." for text in recording.damage)
    lost = Counter[str]()
    for drops in recording.drops():
        lost[drops.topic] += drops.count
    return damage + tuple(f"{count} messages of {topic} were not recorded." for topic, count in lost.items())


def _tiles(summary: MissionSummary | None, estimates: list[Located]) -> tuple[Tile, ...]:
    tiles: list[Tile] = []
    locate, contact = (None, None) if summary is None else (summary.locate, summary.contact)
    if locate is not None and locate.error_mm is not None and locate.error_deg is not None:
        tiles.append(Tile("located pose against truth", f"{locate.error_mm:.2f}", "mm"))
        tiles.append(Tile("its orientation", f"{locate.error_deg:.2f}", "°"))
    if estimates:
        last = estimates[-1].estimate
        tiles.append(Tile("rms residual", f"{1e3 * last.rms_residual_m:.2f}", "mm"))
        tiles.append(Tile("of the visible model seen", f"{100 * last.inlier_ratio:.0f}", "%"))
    if contact is not None:
        tiles.append(Tile("lateral offset at contact", f"{contact.lateral_mm:.2f}", "mm"))
        tiles.append(Tile("tilt at contact", f"{contact.tilt_deg:.2f}", "°"))
        tiles.append(Tile("peak force", f"{contact.peak_force_n:.0f}", "N"))
    return tuple(tiles)


def _estimated_pose(view: Alignment | None) -> str:
    if view is None:
        return ""
    estimate = view.estimate
    verdict = "accepted" if estimate.accepted else "refused"
    return f"T_{estimate.ref}_port = {place_of(estimate.T_ref_port)}, {verdict}."


def _estimate_row(located: Located, start_s: float) -> EstimateRow:
    e = located.estimate
    return EstimateRow(
        at=f"{located.time_s - start_s:.1f} s",
        accepted=e.accepted,
        verdict=e.verdict,
        rms=f"{1e3 * e.rms_residual_m:.2f} mm",
        seen=f"{100 * e.inlier_ratio:.0f} %",
        margin=f"{e.runner_up_margin:.2f}",
        sigma=f"{1e3 * sigma(e.covariance[:3, :3]):.3f} mm",
        took=f"{e.elapsed_s:.2f} s",
        reasons=e.reasons,
    )


def _contact_row(contacted: Contacted) -> ContactRow:
    c = contacted.contact
    along, lateral = f"{c.along_mm:.2f}", f"{c.lateral_mm:.2f}"
    roll, tilt, force = f"{c.roll_deg:.2f}", f"{c.tilt_deg:.2f}", f"{c.peak_force_n:.1f}"
    return ContactRow(contacted.attempt, along, lateral, roll, tilt, force)


def _refusal_row(decision: Decision, start_s: float) -> RefusalRow:
    return RefusalRow(f"{decision.time_s - start_s:.1f} s", decision.name, decision.detail, decision.reason)


def _link_row(report: LinkReport) -> LinkRow:
    counters = ", ".join(f"{name.replace('_', ' ')} {count:,}" for name, count in report.health.counters)
    return LinkRow(report.link, report.health.up, counters, report.health.detail)


def _transition_rows(recording: Recording, spans: tuple[StateSpan, ...]) -> tuple[TransitionRow, ...]:
    return tuple(
        TransitionRow(
            f"{span.start_s:.2f} s", step.from_state, step.event, step.to_state, f"{span.end_s - span.start_s:.2f} s"
        )
        for step, span in zip(recording.transitions(), spans, strict=True)
    )


def _recorded(recording: Recording) -> tuple[tuple[str, str], ...]:
    """Metadata, then what the file holds."""
    tables = [(name, table) for name, table in recording.metadata.items() if name != "summary"]
    rows = [(f"{name}: {key}", value) for name, table in tables for key, value in table.items()]
    rows += [(topic, f"{len(messages):,} messages") for topic, messages in sorted(recording.topics.items())]
    rows += [(a.name, f"{len(a.data):,} bytes, {a.media_type}") for a in recording.attachments.values()]
    return tuple(rows)
