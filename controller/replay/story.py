"""What a replay has to know before it begins, read out of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import yaml

from controller.config import SiteConfig, parse_config
from controller.config_section import ConfigError
from controller.durable import INSERTION_NAME
from controller.recording.errors import RecordingFileError
from controller.recording.reader import Recording
from controller.states import Event, State
from controller.task import Goal

_ASKED_BEFORE_S = 0.001
HEARD_BEFORE_S = 0.5
"""An older recording of a daemon lacks what the bus had said before the job: so much of it is heard at once."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What an operator asked for in the recording."""

    time_s: float
    abort: bool


@dataclass(frozen=True, slots=True)
class Story:
    """How the recorded mission began."""

    config: SiteConfig
    pace: float
    """Mission seconds per host second: not 1 only for a dry run with ``--fast``."""
    goal: Goal
    state: State
    first: Event
    """What led out of that state."""
    insertion: bytes
    """The stored axis that it began with; empty if none was."""
    start_s: float
    """Host's time of the first transition."""
    asked: tuple[Asked, ...]
    model_checksum: str
    heard_s: float
    """Bus traffic up to here was known when the mission began."""
    end_s: float
    """Host's time of the last arm sample."""
    complete: bool
    """Whether the recording has an end."""


def story_of(recording: Recording) -> Story:
    """Raises RecordingFileError for a recording that no mission can be replayed from."""
    steps = recording.transitions()
    if not steps:
        raise RecordingFileError(f"{recording.path} holds no mission: no state was entered")
    facts = recording.metadata.get("mission", {})
    first = steps[0]
    try:
        goal, state = Goal(facts.get("goal", Goal.CYCLE.value)), State[first.from_state]
        event = Event(first.event)
        pace = float(facts.get("pace", "1"))
    except (KeyError, ValueError) as error:
        raise RecordingFileError(f"{recording.path} speaks of what this version does not know: {error}") from error
    return Story(
        config=_config(recording),
        pace=pace,
        goal=goal,
        state=state,
        first=event,
        insertion=stored.data if (stored := recording.attachments.get(INSERTION_NAME)) else b"",
        start_s=first.time_s,
        asked=_asked(recording),
        model_checksum=facts.get("model", ""),
        heard_s=first.time_s + (0.0 if state is State.OFFLINE or "pace" in facts else HEARD_BEFORE_S),
        end_s=_end_s(recording),
        complete=recording.summary() is not None,
    )


def _config(recording: Recording) -> SiteConfig:
    attached = recording.attachments.get("config.yaml")
    if attached is None:
        raise RecordingFileError(f"{recording.path} holds no configuration")
    try:
        values = yaml.safe_load(attached.data)
        return parse_config(values if isinstance(values, dict) else {})
    except (yaml.YAMLError, UnicodeDecodeError, ConfigError) as error:
        cause = error.cause if isinstance(error, ConfigError) else "it is no YAML"
        raise RecordingFileError(f"the configuration in {recording.path} cannot be used: {cause}") from error


def _end_s(recording: Recording) -> float:
    samples = recording.arm_table()
    return float(samples["time_s"][-1]) if len(samples) else recording.transitions()[-1].time_s


def _asked(recording: Recording) -> tuple[Asked, ...]:
    """An operator's stop and abort, a moment before the first thing that they made happen."""
    stops = [decision.time_s for decision in recording.decisions() if decision.name == "StopMotion"]
    halts = [command.time_s for command in recording.arm_commands() if command.name == "stop"]
    found: list[Asked] = []
    entered_s = 0.0
    for step in recording.transitions():
        if step.event in (Event.STOP.value, Event.ABORT.value):
            abort = step.event == Event.ABORT.value
            before = [time_s for time_s in (halts if abort else stops) if entered_s <= time_s <= step.time_s]
            found.append(Asked((before[-1] if before else step.time_s) - _ASKED_BEFORE_S, abort))
        entered_s = step.time_s
    return tuple(found)
