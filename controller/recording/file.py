"""The MCAP file under a recorder: channels, chunks, and what makes them survive a crash.

Every finished chunk is handed to the operating system at once (no buffer of our own in between), so it survives the
process being killed; ``sync`` finishes the chunk and waits for the disk, so it survives a power cut. Not thread-safe:
one writer owns it. Raises OSError when the disk refuses.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from controller.recording.schemas import FORMAT_VERSION, TOPICS, Topic

LIBRARY = "portdock"


class RecordingFile:
    """One recording being written."""

    def __init__(self, path: Path, *, chunk_bytes: int, wall_offset_ns: int) -> None:
        """Create the file. ``wall_offset_ns`` added to the host's monotonic time gives the wall clock's."""
        self._wall_offset_ns = wall_offset_ns
        self._stream = _UnbufferedFile(path)
        self._pending = 0
        try:
            self._writer = Writer(self._stream, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
            self._writer.start(profile="", library=LIBRARY)
            self._channels = {topic.name: self._register(topic) for topic in TOPICS}
            self.metadata("format", {"version": FORMAT_VERSION, "wall_offset_ns": str(wall_offset_ns)})
        except BaseException:  # a full disk: neither a descriptor nor a recording of a few bytes is left behind
            self._stream.close()
            with contextlib.suppress(OSError):
                path.unlink()
            raise

    def message(self, topic: Topic, time_ns: int, sequence: int, data: bytes) -> None:
        """Append one message with the host's monotonic time ``time_ns`` and its number within the topic."""
        self._pending += 1
        self._writer.add_message(
            channel_id=self._channels[topic.name],
            log_time=self.wall_ns(time_ns),
            data=data,
            publish_time=max(0, time_ns),
            sequence=sequence & 0xFFFFFFFF,
        )

    def attachment(self, name: str, data: bytes, media_type: str, time_ns: int) -> None:
        """Put a file into the recording."""
        wall_ns = self.wall_ns(time_ns)
        self._writer.add_attachment(create_time=wall_ns, log_time=wall_ns, name=name, media_type=media_type, data=data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a small table of texts into the recording."""
        self._writer.add_metadata(name, dict(values))

    def finish_chunk(self) -> None:
        """Hand everything to the operating system; a chunk without messages is not written."""
        if self._pending:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._pending = 0

    def sync(self) -> None:
        """Everything so far is on the disk when this returns."""
        self.finish_chunk()
        self._stream.sync()

    def finish(self) -> None:
        """Write index and footer, wait for the disk, close."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.sync()
        self._stream.close()

    def abandon(self) -> None:
        """Close without index and footer, as after an error of the disk. What was written stays readable."""
        self._stream.close()

    def wall_ns(self, time_ns: int) -> int:
        """The wall clock's ns for a host's monotonic time."""
        return max(0, time_ns + self._wall_offset_ns)

    def _register(self, topic: Topic) -> int:
        schema = self._writer.register_schema(topic.schema_name, topic.schema_encoding, topic.schema)
        return self._writer.register_channel(topic.name, topic.message_encoding, schema)


def is_being_written(path: Path) -> bool:
    """Whether a recorder, in this process or another, has the file open; False for a file that cannot be opened."""
    try:
        with path.open("rb") as stream:
            fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


class _UnbufferedFile:
    """The part of a binary file that the MCAP writer uses, each write going straight to the operating system."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        with contextlib.suppress(OSError):  # some network file systems cannot lock; only pruning asks
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._position = 0

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            written = os.write(self._descriptor, rest)
            self._position += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing is held back."""

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
