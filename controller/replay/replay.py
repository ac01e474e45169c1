"""Runs a recorded mission through the controller once more and names the first difference."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from controller import wiring
from controller.assembly import cell_of, mated_pose
from controller.cell import Locator
from controller.durable import INSERTION_NAME
from controller.faults import Fault, FaultCode
from controller.looking import Looking
from controller.mission import Mission
from controller.pace import PacedClock
from controller.perception_worker import PerceptionHere
from controller.recording.compare import Difference, first_difference
from controller.recording.reader import Recording
from controller.replay.evidence import ReplayEvidence
from controller.replay.story import Story, story_of
from controller.replay.ticking import ReplaySupervisor
from controller.rough_look import CoarseStage
from controller.self_check import stored_plan
from controller.sources import Sources
from controller.states import State
from controller.task import Goal
from drivers.playback import EndOfRecording, Playback
from perception.estimate import PortEstimate, Prior
from perception.rough import RoughPlace
from perception.scan import Cloud

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """What a replay came to."""

    difference: Difference | None
    states: tuple[str, ...]
    outcome: str | None
    decisions: int
    arm_commands: int
    estimates: int
    ended: str
    """Why the replay ended before its mission did; empty otherwise."""
    complete: bool
    """Whether the recording has an end; a cut one is compared as far as it goes."""


class _Perception(Locator, Protocol):
    """What a replay asks: for the port, and for where it roughly is."""

    def submit_rough(self, cloud: Cloud, prior: Prior) -> Future[RoughPlace]: ...


class _Recorded:
    """Perception that answers as it did: what then differs is the controller's doing."""

    def __init__(self, recording: Recording, evidence: ReplayEvidence, model: str) -> None:
        self._answers, self._evidence, self._model = recording.estimates(), evidence, model

    def submit_rough(self, cloud: Cloud, prior: Prior) -> Future[RoughPlace]:
        """Found anew: it decides where the precise scanner looks, and is not recorded."""
        return PerceptionHere(self._model).submit_rough(cloud, prior)

    def submit(self, clouds: Sequence[Cloud], prior: Prior) -> Future[PortEstimate]:
        """The recorded answer that comes next; after the last one, none ever."""
        number = len(self._evidence.estimates())
        future: Future[PortEstimate] = Future()
        if number < len(self._answers):  # else what was asked was never answered: the mission ended meanwhile
            future.set_result(self._answers[number].estimate)
        return future


def replay(
    recording: Recording, show: Callable[[str], None] = lambda state: None, *, recorded_estimates: bool = False
) -> ReplayResult:
    """Run it. ``show`` is told each state. Raises InputError for what cannot be replayed.

    ``recorded_estimates``: perception is not asked, its recorded answers are given.
    """
    story = story_of(recording)
    playback = Playback(story.start_s)
    evidence = ReplayEvidence(recording, playback)
    evidence.show = show
    ended = ""
    with tempfile.TemporaryDirectory(prefix="portdock-replay-") as memory:
        locator: _Perception = (
            _Recorded(recording, evidence, story.config.port.model) if recorded_estimates else _perception(story)
        )
        mission = _mission(recording, story, playback, evidence, locator, Path(memory))
        try:
            _run(mission, story)
        except EndOfRecording as end:
            ended = str(end)
    difference = first_difference(recording, evidence, cut=not story.complete)
    steps = evidence.transitions()
    return ReplayResult(
        difference=difference,
        states=tuple(step.to_state for step in steps),
        outcome=None if evidence.outcome is None else evidence.outcome.kind,
        decisions=len(evidence.decisions()),
        arm_commands=len(evidence.arm_commands()),
        estimates=len(evidence.estimates()),
        ended=ended,
        complete=story.complete,
    )


def _run(mission: Mission, story: Story) -> None:
    if story.state is State.OFFLINE:
        mission.run(story.goal)
        return
    _take_up(mission, story)
    mission.go_on(story.state, story.goal, story.first)


def _take_up(mission: Mission, story: Story) -> None:
    """What a daemon knows in a state of rest."""
    task = mission.task
    if story.insertion:
        (task.state_folder / INSERTION_NAME).write_bytes(story.insertion)
    docked = story.state is State.CHARGING
    if story.state is State.FAULT and story.goal is Goal.UNDOCK:
        mission.fault = Fault(FaultCode.PLUG_INSERTED_AT_START)  # no other is left by an undocking
    task.plan = stored_plan(task)
    task.cell.T_base_port = None if task.plan is None else task.plan.T_base_port
    task.charging_seen = task.cell.supervisor.facts.mated = docked
    task.cell.supervisor.facts.clear_of_vehicle = not docked and task.plan is None


def _perception(story: Story) -> PerceptionHere:
    perception = PerceptionHere(story.config.port.model)
    if story.model_checksum and perception.checksum != story.model_checksum:
        log.warning("the port model '%s' is another one than in the recording", story.config.port.model)
    return perception


def _mission(
    recording: Recording,
    story: Story,
    playback: Playback,
    evidence: ReplayEvidence,
    locator: _Perception,
    memory: Path,
) -> Mission:
    config = story.config
    clock = PacedClock(story.pace, playback)
    devices = wiring.build_played_devices(config, recording, evidence, playback, story.heard_s)
    for device in (devices.charger, devices.scanner, devices.coarse, devices.arm):
        if device is not None:
            device.open()
    sources = Sources(devices.arm, devices.charger, devices.scanner)
    supervisor = ReplaySupervisor(sources, clock, playback, config.host.stall_ms / 1000.0, story)
    supervisor.coming_fault = evidence.coming_fault
    cell = cell_of(config, devices, locator, supervisor, clock, playback, evidence)
    coarse = None if devices.coarse is None else CoarseStage(devices.coarse, locator.submit_rough)
    return Mission(cell, config, mated_pose(config), evidence, memory, lambda: Looking(cell, config, coarse))
