"""One MCAP file for each mission: what the links carried, what was decided and why.

Every method only queues and returns, so that reader threads and the supervisor's tick never wait for the disk
(``writer.py``). Samples of the links may be dropped, counted and named; the mission's own events (transitions,
decisions, estimates) never are.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

from controller.recording import messages, schemas
from controller.recording.errors import RecordingError
from controller.recording.records import encode_arm_state, encode_can_frame, encode_scanner_bytes
from controller.recording.values import Contacted, Decision, Level, LinkReport, Located, Note, SweepTaken, Transition
from controller.recording.writer import RecordingWriter, to_ns
from controller.summary import ContactSummary, MissionSummary
from drivers.base import ArmCommandRecord, ArmState, CanFrame, Clock, Direction, LinkHealth
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud

_TF_PERIOD_S = 0.1
_SCANNER_TOPICS = {"rx": schemas.SCANNER_RX, "tx": schemas.SCANNER_TX}
_COARSE_TOPICS = {"rx": schemas.COARSE_RX, "tx": schemas.COARSE_TX}


class Recorder:
    """Writes one recording; implements ``drivers.base.ByteSink``. Thread-safe."""

    def __init__(
        self,
        path: Path,
        clock: Clock,
        *,
        chunk_bytes: int = 128 * 1024,
        backlog_bytes: int = 16 * 1024 * 1024,
        wall_time_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Create the file (and its folder) and start the writer. Raises RecordingTargetError, also if the file exists.

        ``clock`` is the host's monotonic clock that the drivers stamp with, never a paced one.
        """
        self.path = path
        self._clock = clock
        self._writer = RecordingWriter(path, clock, chunk_bytes, backlog_bytes, wall_time_ns)
        self._next_tf_s = -1.0

    # --- samples of the links: from reader threads, dropped when the disk does not keep up ----------------------------

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """One chunk of the serial line."""
        self._chunk(_SCANNER_TOPICS[direction], bytes(data), host_time_ns)

    def coarse_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """One chunk of the coarse scanner's line."""
        self._chunk(_COARSE_TOPICS[direction], bytes(data), host_time_ns)

    def _chunk(self, topic: schemas.Topic, data: bytes, host_time_ns: int) -> None:
        self._writer.sample(topic, len(data), host_time_ns, lambda: encode_scanner_bytes(host_time_ns, data))

    def can_frame(self, frame: CanFrame) -> None:
        """One CAN frame, either direction."""
        self._writer.sample(schemas.CAN, 64, to_ns(frame.time_s), lambda: encode_can_frame(frame))

    def arm_state(self, state: ArmState) -> None:
        """One sample of the arm; ten times a second also as transforms base -> flange -> tcp."""
        self._writer.sample(schemas.ARM, 512, to_ns(state.time_s), lambda: encode_arm_state(state))
        if not self._next_tf_s - _TF_PERIOD_S <= state.time_s < self._next_tf_s:
            self._next_tf_s = state.time_s + _TF_PERIOD_S
            self._frames_of(state)

    def arm_command(self, record: ArmCommandRecord) -> None:
        """One call to the arm: an event of the mission, never dropped."""
        self._writer.event(schemas.ARM_COMMAND, record.time_s, lambda: messages.encode_arm_command(record))

    # --- events of the mission: never dropped -------------------------------------------------------------------------

    def transition(self, from_state: str, event: str, to_state: str, time_s: float) -> None:
        """A step of the state machine at the mission's time ``time_s``; the file is synced in the background."""
        step = Transition(self._clock.now_s(), from_state, event, to_state, time_s)
        self._writer.event(schemas.STATE, step.time_s, lambda: messages.encode_transition(step))
        self._writer.submit(lambda file: file.sync())

    def command(self, name: str, detail: str, allowed: bool, reason: str = "") -> None:
        """What the safety gate said to a command."""
        decision = Decision(self._clock.now_s(), name, detail, allowed, reason)
        self._writer.event(schemas.COMMAND, decision.time_s, lambda: messages.encode_decision(decision))

    def estimate(self, estimate: PortEstimate) -> None:
        """An answer of the locator; an accepted one also as Foxglove pose and transform."""
        located = Located(self._clock.now_s(), estimate)
        self._writer.event(schemas.ESTIMATE, located.time_s, lambda: messages.encode_estimate(located))
        if estimate.accepted:
            self._dock_pose(estimate, located.time_s)

    def scan(self, cloud: Cloud) -> None:
        """The cloud of a finished sweep."""
        time_s = self._clock.now_s()
        wall_ns = self._writer.wall_ns(to_ns(time_s))
        self._writer.event(schemas.POINTS, time_s, lambda: messages.encode_cloud(cloud, wall_ns))

    def waited(self, time_s: float) -> None:
        """The mission stopped waiting for something, for what it knew at ``time_s``: a replay goes on there too."""
        self._writer.event(schemas.WAIT, time_s, lambda: messages.encode_wait(time_s))

    def swept(self, profiles: int, arm_first_s: float, arm_last_s: float) -> None:
        """What a sweep was made of, whether or not it could be used."""
        taken = SweepTaken(self._clock.now_s(), profiles, arm_first_s, arm_last_s)
        self._writer.event(schemas.SWEEP, taken.time_s, lambda: messages.encode_sweep(taken))

    def contact(self, attempt: int, contact: ContactSummary) -> None:
        """The contact numbers of an attempt, failed or not."""
        contacted = Contacted(self._clock.now_s(), attempt, contact)
        self._writer.event(schemas.CONTACT, contacted.time_s, lambda: messages.encode_contact(contacted))

    def link(self, name: str, health: LinkHealth) -> None:
        """The health of a link."""
        report = LinkReport(self._clock.now_s(), name, health)
        self._writer.event(schemas.LINK, report.time_s, lambda: messages.encode_link(report))

    def note(self, level: Level, text: str) -> None:
        """A line of the mission's log."""
        note = Note(self._clock.now_s(), level, text)
        wall_ns = self._writer.wall_ns(to_ns(note.time_s))
        self._writer.event(schemas.LOG, note.time_s, lambda: messages.encode_note(note, wall_ns))

    def transform(self, parent: str, child: str, T_parent_child: Pose, time_s: float | None = None) -> None:
        """A frame for viewers, such as scanner in flange."""
        at_s = self._clock.now_s() if time_s is None else time_s
        wall_ns = self._writer.wall_ns(to_ns(at_s))
        encode = messages.encode_transform
        self._writer.event(schemas.TRANSFORM, at_s, lambda: encode(parent, child, T_parent_child, wall_ns))

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """A file inside the recording: effective configuration, DBC, the port model's sample points."""
        time_ns = to_ns(self._clock.now_s())
        self._writer.submit(lambda file: file.attachment(name, data, media_type, time_ns))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """A small table of texts: versions, seed, host."""
        table = {str(key): str(value) for key, value in values.items()}
        self._writer.submit(lambda file: file.metadata(name, table))

    # --- life ---------------------------------------------------------------------------------------------------------

    @property
    def failure(self) -> RecordingError | None:
        """Why recording ended early, or None."""
        return self._writer.failure

    @property
    def dropped(self) -> int:
        """Samples dropped and not yet named in the recording."""
        return self._writer.dropped

    def flush(self, timeout_s: float = 5.0) -> None:
        """Return when everything handed over so far is on the disk.

        Raises RecordingError if it is not within ``timeout_s``, or, once, if the recording has failed.
        """
        self._writer.flush(timeout_s)

    def close(self, outcome: MissionSummary | None = None) -> None:
        """Write the result, finish the file, stop the writer. Idempotent; never raises (see ``failure``)."""
        if outcome is not None:
            self.metadata("summary", {"json": messages.encode_summary(outcome)})
        self._writer.close()

    # --- inside -------------------------------------------------------------------------------------------------------

    def _frames_of(self, state: ArmState) -> None:
        time_ns = to_ns(state.time_s)
        wall_ns, encode = self._writer.wall_ns(time_ns), messages.encode_transform
        self._writer.sample(
            schemas.TRANSFORM, 256, time_ns, lambda: encode("base", "flange", state.T_base_flange, wall_ns)
        )
        self._writer.sample(
            schemas.TRANSFORM, 256, time_ns, lambda: encode("flange", "tcp", state.T_flange_tcp, wall_ns)
        )

    def _dock_pose(self, estimate: PortEstimate, time_s: float) -> None:
        wall_ns = self._writer.wall_ns(to_ns(time_s))
        pose, frame = estimate.T_ref_port, estimate.ref
        self._writer.event(schemas.DOCK_POSE, time_s, lambda: messages.encode_pose_in_frame(pose, frame, wall_ns))
        self.transform(frame, "port", pose, time_s)
