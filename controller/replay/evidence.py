"""What a replayed mission does, kept in memory and held against the recording as it happens.

Each thing that the mission does moves the clock to when it was done in the recording, so that time stamps, freshness
and the joined clouds come out as they did then.
"""

from __future__ import annotations

from collections.abc import Callable

from controller.faults import Outcome
from controller.insertion import Insertion
from controller.recording.compare import EDGE, deliberate
from controller.recording.reader import Recording
from controller.recording.values import Decision, Located, Scanned, Transition
from controller.states import State
from controller.task import Goal, Progress
from drivers.base import ArmCommandRecord, ArmState, CanFrame, Direction
from drivers.playback import EndOfRecording, Playback
from perception.estimate import PortEstimate
from perception.scan import Cloud

DECISION, STATE, ESTIMATE, WAIT = "decision", "state", "estimate", "wait"
_SAFE = {("StopMotion", ""), ("Laser", "off"), ("Announce", "none")}
"""Decisions that a mission still makes on its way into FAULT."""


class ReplayEvidence:
    """Recorder and watcher of a replay; offers what ``first_difference`` compares."""

    def __init__(self, recording: Recording, playback: Playback) -> None:
        self._playback = playback
        self._expected_decisions = deliberate(recording.decisions())
        self._expected_steps = recording.transitions()
        playback.cue(DECISION, [decision.time_s for decision in self._expected_decisions])
        playback.cue(STATE, [step.time_s for step in self._expected_steps])
        playback.cue(ESTIMATE, [located.time_s for located in recording.estimates()])
        playback.cue(WAIT, recording.waits())
        self._decisions: list[Decision] = []
        self._steps: list[Transition] = []
        self._estimates: list[Located] = []
        self._scans: list[Scanned] = []
        self._arm: list[ArmCommandRecord] = []
        self.outcome: Outcome | None = None
        self.show: Callable[[str], None] = lambda state: None
        """Told the name of each state that is entered."""

    # --- for the comparison -------------------------------------------------------------------------------------------

    def transitions(self) -> list[Transition]:
        """The state trace."""
        return self._steps

    def estimates(self) -> list[Located]:
        """Answers of the locator."""
        return self._estimates

    def decisions(self) -> list[Decision]:
        """What the gate said."""
        return self._decisions

    def arm_commands(self) -> list[ArmCommandRecord]:
        """Calls to the arm."""
        return self._arm

    def scans(self) -> list[Scanned]:
        """The joined clouds."""
        return self._scans

    def coming_fault(self) -> Transition | None:
        """The recording's next transition, if it leads to FAULT and nothing is decided before but what makes safe."""
        coming = self._expected_steps[len(self._steps) : len(self._steps) + 1]
        if not coming or coming[0].to_state != State.FAULT.name:
            return None
        before = [one for one in self._expected_decisions[len(self._decisions) :] if one.time_s < coming[0].time_s]
        return coming[0] if all((one.name, one.detail) in _SAFE for one in before) else None

    # --- CommandLog and Watcher ---------------------------------------------------------------------------------------

    def command(self, name: str, detail: str, allowed: bool, reason: str) -> None:
        if name == EDGE and allowed:
            return
        decision = Decision(self._playback.now_s(), name, detail, allowed, reason)
        self._decisions.append(decision)
        number = len(self._decisions) - 1
        if number < len(self._expected_decisions):
            expected = self._expected_decisions[number]
            if (expected.name, expected.allowed) != (name, allowed):
                raise EndOfRecording(f"{name} was not the next decision")
        self._playback.did(DECISION)

    def transition(self, source: str, event: str, target: str, time_s: float) -> None:
        self._steps.append(Transition(self._playback.now_s(), source, event, target, time_s))
        number = len(self._steps) - 1
        if number < len(self._expected_steps):
            expected = self._expected_steps[number]
            if (expected.from_state, expected.event, expected.to_state) != (source, event, target):
                raise EndOfRecording(f"{source} -> {target} was not the next transition")
            self._playback.skip_cues(WAIT, expected.time_s)  # of a wait that ended otherwise here, by a stop perhaps
        self._playback.did(STATE)
        self.show(target)

    def estimate(self, estimate: PortEstimate) -> None:
        self._estimates.append(Located(self._playback.now_s(), estimate))
        self._playback.did(ESTIMATE)

    def scan(self, cloud: Cloud) -> None:
        self._scans.append(Scanned(self._playback.now_s(), cloud))

    def began(self, goal: Goal) -> None: ...
    def progress(self, label: str, fraction: float, detail: str) -> None: ...
    def insertion(self, insertion: Insertion) -> None: ...

    def ended(self, outcome: Outcome, job: Progress) -> None:
        self.outcome = outcome

    # --- ByteSink: what is played back is not recorded again ----------------------------------------------------------

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None: ...
    def coarse_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None: ...
    def can_frame(self, frame: CanFrame) -> None: ...
    def arm_state(self, state: ArmState) -> None: ...

    def arm_command(self, record: ArmCommandRecord) -> None:
        self._arm.append(record)
