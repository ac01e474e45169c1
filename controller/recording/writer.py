"""The thread that writes a recording: what others hand over is queued, and never makes them wait for the disk.

When the disk does not keep up, samples are dropped, counted and named in the recording; events never are. When the disk
refuses, recording ends and what was written so far stays readable: ``failure`` says why and ``flush`` raises it, once.
Nothing else raises: a full disk never breaks into a reader thread or into a transition with the plug in the port.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path

from controller.recording import messages, schemas
from controller.recording.backlog import Backlog, Tally
from controller.recording.errors import RecordingError, RecordingTargetError
from controller.recording.file import RecordingFile
from controller.recording.values import Drops
from drivers.base import Clock

logger = logging.getLogger(__name__)

Job = Callable[[RecordingFile], None]

_CHUNK_PERIOD_S = 1.0
"""A crash of the process loses at most this much."""
_IDLE_S = 0.05


class RecordingWriter:
    """One file, its backlog and the thread that works it off. Thread-safe."""

    def __init__(
        self, path: Path, clock: Clock, chunk_bytes: int, backlog_bytes: int, wall_time_ns: Callable[[], int]
    ) -> None:
        """Create the file (and its folder), start the thread. Raises RecordingTargetError, also if the file exists."""
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
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    # --- from any thread ----------------------------------------------------------------------------------------------

    def wall_ns(self, time_ns: int) -> int:
        """The wall time of a monotonic one."""
        return self._file.wall_ns(time_ns)

    def sample(self, topic: schemas.Topic, size: int, time_ns: int, encode: Callable[[], bytes]) -> None:
        """A message of about ``size`` bytes, dropped when the disk does not keep up."""
        if self._failure is not None or self._closing:
            return
        with self._order:
            number = self._tally.next_number(topic.name)
            kept = self._backlog.offer(lambda file: self._append(file, topic, time_ns, number, encode), size)
        if not kept:
            self._tally.lose(topic.name)

    def event(self, topic: schemas.Topic, time_s: float, encode: Callable[[], bytes]) -> None:
        """A message that is never dropped."""
        time_ns = to_ns(time_s)
        with self._order:
            number = self._tally.next_number(topic.name)
            self.submit(lambda file: self._append(file, topic, time_ns, number, encode))

    def submit(self, job: Job, *, urgent: bool = False) -> None:
        """Something to be done with the file in its turn."""
        if self._failure is None and not self._closing:
            self._backlog.put(job)
            if urgent:
                self._backlog.wake()

    @property
    def failure(self) -> RecordingError | None:
        """Why recording ended early, or None."""
        return self._failure

    @property
    def dropped(self) -> int:
        """Samples dropped and not yet named in the recording."""
        return self._tally.lost

    def flush(self, timeout_s: float) -> None:
        """Return when everything handed over so far is on the disk. Raises as ``Recorder.flush`` does."""
        done = threading.Event()

        def sync(file: RecordingFile) -> None:
            file.sync()
            done.set()

        self.submit(sync, urgent=True)
        deadline = time.monotonic() + timeout_s
        while not done.wait(0.02):
            self._raise_failure_once()
            if self._failure is not None or not self._thread.is_alive():
                return
            if time.monotonic() > deadline:
                raise RecordingError(f"the recording {self.path} is not on the disk after {timeout_s:g} s")

    def close(self) -> None:
        """Finish the file, stop the thread. Idempotent; never raises."""
        if self._closing:
            return
        self._closing = True
        self._backlog.wake()
        self._thread.join(30.0)
        if self._thread.is_alive():
            logger.error("the recorder's writer hangs in the disk; %s lacks its end", self.path)

    def _raise_failure_once(self) -> None:
        if self._failure is not None and not self._failure_raised:
            self._failure_raised = True
            raise self._failure

    # --- the thread ---------------------------------------------------------------------------------------------------

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


def to_ns(time_s: float) -> int:
    """Monotonic seconds as whole nanoseconds."""
    return round(time_s * 1e9)
