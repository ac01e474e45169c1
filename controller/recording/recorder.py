"""One MCAP file for each mission: what the links carried, what was decided and why.

Every method only queues and returns, so that reader threads and the supervisor's tick never wait for the disk; one
thread of its own writes. When the disk does not keep up, the samples of the links are dropped, counted and named in
the recording; the mission's own events (transitions, decisions, estimates) never are. When the disk refuses,
recording ends and what was written so far stays readable: ``failure`` says why and ``flush`` raises it, once. Nothing
else raises, so that a full disk never breaks into a reader thread or into a transition with the plug in the port.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from controller.recording import messages, schemas
from controller.recording.backlog import Backlog, Tally
from controller.recording.errors import RecordingError, RecordingTargetError
from controller.recording.file import RecordingFile
from controller.recording.records import encode_arm_state, encode_can_frame, encode_scanner_bytes
from controller.recording.values import (
    Contacted,
    Decision,
    Drops,
    Level,
    LinkReport,
    Located,
    Note,
    SweepTaken,
    Transition,
)
from controller.summary import ContactSummary, MissionSummary
from drivers.base import ArmCommandRecord, ArmState, CanFrame, Clock, Direction, LinkHealth
from perception.estimate import PortEstimate
from perception.geometry import Pose
from perception.scan import Cloud

logger = logging.getLogger(__name__)

Job = Callable[[RecordingFile], None]

_CHUNK_PERIOD_S = 1.0
"""A crash of the process loses at most this much."""
_IDLE_S = 0.05
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
        offset_ns = wall_time_ns() - to_ns(clock.now_s())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = RecordingFile(path, chunk_bytes=chunk_bytes, wall_offset_ns=offset_ns)
        except FileExistsError as error:
            remedy = "Give another folder with --out; a recording is evidence and is never overwritten."
            raise RecordingTargetError(f"the recording {path} exists already", remedy=remedy) from error
        except OSError as error:
            raise RecordingTargetError(f"cannot write the recording {path}: {error.strerror}") from error
        self._backlog: Backlog[Job] = Backlog(backlog_bytes)
        self._order = threading.Lock()
        self._tally = Tally()
        self._failure: RecordingError | None = None
        self._failure_raised = False
        self._closing = False
        self._next_tf_s = -1.0
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    # --- samples of the links: from reader threads, dropped when the disk does not keep up ----------------------------

    def scanner_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """One chunk of the serial line."""
        self._chunk(_SCANNER_TOPICS[direction], bytes(data), host_time_ns)

    def coarse_bytes(self, direction: Direction, data: bytes, host_time_ns: int) -> None:
        """One chunk of the coarse scanner's line."""
        self._chunk(_COARSE_TOPICS[direction], bytes(data), host_time_ns)

    def _chunk(self, topic: schemas.Topic, data: bytes, host_time_ns: int) -> None:
        self._sample(topic, len(data), host_time_ns, lambda: encode_scanner_bytes(host_time_ns, data))

    def can_frame(self, frame: CanFrame) -> None:
        """One CAN frame, either direction."""
        self._sample(schemas.CAN, 64, to_ns(frame.time_s), lambda: encode_can_frame(frame))

    def arm_state(self, state: ArmState) -> None:
        """One sample of the arm; ten times a second also as transforms base -> flange -> tcp."""
        self._sample(schemas.ARM, 512, to_ns(state.time_s), lambda: encode_arm_state(state))
        if not self._next_tf_s - _TF_PERIOD_S <= state.time_s < self._next_tf_s:
            self._next_tf_s = state.time_s + _TF_PERIOD_S
            self._frames_of(state)

    def arm_command(self, record: ArmCommandRecord) -> None:
        """One call to the arm: an event of the mission, never dropped."""
        self._event(schemas.ARM_COMMAND, record.time_s, lambda: messages.encode_arm_command(record))

    # --- events of the mission: never dropped -------------------------------------------------------------------------

    def transition(self, from_state: str, event: str, to_state: str, time_s: float) -> None:
        """A step of the state machine at the mission's time ``time_s``; the file is synced in the background."""
        step = Transition(self._clock.now_s(), from_state, event, to_state, time_s)
        self._event(schemas.STATE, step.time_s, lambda: messages.encode_transition(step))
        self._submit(lambda file: file.sync())

    def command(self, name: str, detail: str, allowed: bool, reason: str = "") -> None:
        """What the safety gate said to a command."""
        decision = Decision(self._clock.now_s(), name, detail, allowed, reason)
        self._event(schemas.COMMAND, decision.time_s, lambda: messages.encode_decision(decision))

    def estimate(self, estimate: PortEstimate) -> None:
        """An answer of the locator; an accepted one also as Foxglove pose and transform."""
        located = Located(self._clock.now_s(), estimate)
        self._event(schemas.ESTIMATE, located.time_s, lambda: messages.encode_estimate(located))
        if estimate.accepted:
            self._dock_pose(estimate, located.time_s)

    def scan(self, cloud: Cloud) -> None:
        """The cloud of a finished sweep."""
        time_s = self._clock.now_s()
        wall_ns = self._file.wall_ns(to_ns(time_s))
        self._event(schemas.POINTS, time_s, lambda: messages.encode_cloud(cloud, wall_ns))

    def waited(self, time_s: float) -> None:
        """The mission stopped waiting for something, for what it knew at ``time_s``: a replay goes on there too."""
        self._event(schemas.WAIT, time_s, lambda: messages.encode_wait(time_s))

    def swept(self, profiles: int, arm_first_s: float, arm_last_s: float) -> None:
        """What a sweep was made of, whether or not it could be used."""
        taken = SweepTaken(self._clock.now_s(), profiles, arm_first_s, arm_last_s)
        self._event(schemas.SWEEP, taken.time_s, lambda: messages.encode_sweep(taken))

    def contact(self, attempt: int, contact: ContactSummary) -> None:
        """The contact numbers of an attempt, failed or not."""
        contacted = Contacted(self._clock.now_s(), attempt, contact)
        self._event(schemas.CONTACT, contacted.time_s, lambda: messages.encode_contact(contacted))

    def link(self, name: str, health: LinkHealth) -> None:
        """The health of a link."""
        report = LinkReport(self._clock.now_s(), name, health)
        self._event(schemas.LINK, report.time_s, lambda: messages.encode_link(report))

    def note(self, level: Level, text: str) -> None:
        """A line of the mission's log."""
        note = Note(self._clock.now_s(), level, text)
        wall_ns = self._file.wall_ns(to_ns(note.time_s))
        self._event(schemas.LOG, note.time_s, lambda: messages.encode_note(note, wall_ns))

    def transform(self, parent: str, child: str, T_parent_child: Pose, time_s: float | None = None) -> None:
        """A frame for viewers, such as scanner in flange."""
        at_s = self._clock.now_s() if time_s is None else time_s
        wall_ns = self._file.wall_ns(to_ns(at_s))
        encode = messages.encode_transform
        self._event(schemas.TRANSFORM, at_s, lambda: encode(parent, child, T_parent_child, wall_ns))

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """A file inside the recording: effective configuration, DBC, the port model's sample points."""
        time_ns = to_ns(self._clock.now_s())
        self._submit(lambda file: file.attachment(name, data, media_type, time_ns))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """A small table of texts: versions, seed, host."""
        table = {str(key): str(value) for key, value in values.items()}
        self._submit(lambda file: file.metadata(name, table))

    # --- life ---------------------------------------------------------------------------------------------------------

    @property
    def failure(self) -> RecordingError | None:
        """Why recording ended early, or None."""
        return self._failure

    @property
    def dropped(self) -> int:
        """Samples dropped and not yet named in the recording."""
        return self._tally.lost

    def flush(self, timeout_s: float = 5.0) -> None:
        """Return when everything handed over so far is on the disk.

        Raises RecordingError if it is not within ``timeout_s``, or, once, if the recording has failed.
        """
        done = threading.Event()

        def sync(file: RecordingFile) -> None:
            file.sync()
            done.set()

        self._submit(sync, urgent=True)
        deadline = time.monotonic() + timeout_s
        while not done.wait(0.02):
            self._raise_failure_once()
            if self._failure is not None or not self._thread.is_alive():
                return
            if time.monotonic() > deadline:
                raise RecordingError(f"the recording {self.path} is not on the disk after {timeout_s:g} s")

    def close(self, outcome: MissionSummary | None = None) -> None:
        """Write the result, finish the file, stop the writer. Idempotent; never raises (see ``failure``)."""
        if self._closing:
            return
        if outcome is not None:
            self.metadata("summary", {"json": messages.encode_summary(outcome)})
        self._closing = True
        self._backlog.wake()
        self._thread.join(30.0)
        if self._thread.is_alive():
            logger.error("the recorder's writer hangs in the disk; %s lacks its end", self.path)

    # --- inside -------------------------------------------------------------------------------------------------------

    def _sample(self, topic: schemas.Topic, size: int, time_ns: int, encode: Callable[[], bytes]) -> None:
        if self._failure is not None or self._closing:
            return
        with self._order:
            number = self._tally.next_number(topic.name)
            kept = self._backlog.offer(lambda file: self._append(file, topic, time_ns, number, encode), size)
        if not kept:
            self._tally.lose(topic.name)

    def _event(self, topic: schemas.Topic, time_s: float, encode: Callable[[], bytes]) -> None:
        time_ns = to_ns(time_s)
        with self._order:
            number = self._tally.next_number(topic.name)
            self._submit(lambda file: self._append(file, topic, time_ns, number, encode))

    def _append(
        self, file: RecordingFile, topic: schemas.Topic, time_ns: int, number: int, encode: Callable[[], bytes]
    ) -> None:
        try:
            data = encode()
        except Exception as error:  # one value that cannot be written must not cost the rest of the evidence
            logger.warning("a message of %s cannot be recorded: %r", topic.name, error)
            self._tally.lose(topic.name)
            return
        file.message(topic, time_ns, number, data)

    def _submit(self, job: Job, *, urgent: bool = False) -> None:
        if self._failure is None and not self._closing:
            self._backlog.put(job)
            if urgent:
                self._backlog.wake()

    def _frames_of(self, state: ArmState) -> None:
        time_ns = to_ns(state.time_s)
        wall_ns, encode = self._file.wall_ns(time_ns), messages.encode_transform
        self._sample(schemas.TRANSFORM, 256, time_ns, lambda: encode("base", "flange", state.T_base_flange, wall_ns))
        self._sample(schemas.TRANSFORM, 256, time_ns, lambda: encode("flange", "tcp", state.T_flange_tcp, wall_ns))

    def _dock_pose(self, estimate: PortEstimate, time_s: float) -> None:
        wall_ns = self._file.wall_ns(to_ns(time_s))
        pose, frame = estimate.T_ref_port, estimate.ref
        self._event(schemas.DOCK_POSE, time_s, lambda: messages.encode_pose_in_frame(pose, frame, wall_ns))
        self.transform(frame, "port", pose, time_s)

    def _raise_failure_once(self) -> None:
        if self._failure is not None and not self._failure_raised:
            self._failure_raised = True
            raise self._failure

    def _write(self) -> None:
        """The writer thread: works the backlog off until closed or refused by the disk."""
        try:
            self._write_until_closed()
            self._file.finish()
        except OSError as error:
            self._fail(RecordingError(f"the recording {self.path} ends early: {error.strerror or error}"))
        except Exception as error:  # whatever it is: the mission must learn that its evidence ends here
            self._fail(RecordingError(f"the recording {self.path} ends early: {error!r}"))

    def _write_until_closed(self) -> None:
        next_chunk_s = time.monotonic() + _CHUNK_PERIOD_S
        while True:
            closing = self._closing
            for job in self._backlog.take_all(0.0 if closing else _IDLE_S):
                job(self._file)
            self._name_drops()
            if time.monotonic() >= next_chunk_s:
                self._file.finish_chunk()
                next_chunk_s = time.monotonic() + _CHUNK_PERIOD_S
            if closing:
                return

    def _name_drops(self) -> None:
        for topic, count in self._tally.take_lost().items():
            drops = Drops(self._clock.now_s(), topic, count)
            number = self._tally.next_number(schemas.DROPS.name)
            self._file.message(schemas.DROPS, to_ns(drops.time_s), number, messages.encode_drops(drops))

    def _fail(self, failure: RecordingError) -> None:
        logger.error("%s", failure.cause)
        self._failure = failure
        self._backlog.take_all(0.0)
        self._file.abandon()


def to_ns(time_s: float) -> int:
    """Monotonic seconds as whole nanoseconds."""
    return round(time_s * 1e9)
