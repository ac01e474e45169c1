"""Reads a recording back into the values that were recorded, also one that a crash cut short or a disk damaged.

The file is read record by record from its beginning; index and footer are not needed. Reading ends where the file
ends or its structure breaks; a chunk that does not match its checksum is left out and named. Nothing here raises
for damage, only for a file that is no recording at all.
"""

from __future__ import annotations

import os
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from mcap import records as mcap_records
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader, breakup_chunk
from numpy.typing import NDArray

from controller.recording import messages, schemas
from controller.recording.errors import RecordingFileError
from controller.recording.records import arm_state, arm_table, decode_can_frame, decode_scanner_bytes
from controller.recording.values import (
    Attachment,
    Contacted,
    Decision,
    Drops,
    LinkReport,
    Located,
    Note,
    Scanned,
    ScannerChunk,
    SweepTaken,
    Transition,
)
from controller.summary import MissionSummary
from drivers.base import ArmCommandRecord, ArmState, CanFrame, Direction

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One message as it lies in the file."""

    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes

    @property
    def time_s(self) -> float:
        """The host's monotonic time."""
        return self.publish_time_ns * 1e-9


class Recording:
    """Everything in one recording, decoded when asked for. Made by ``read_recording``."""

    def __init__(
        self,
        path: Path,
        topics: dict[str, list[RawMessage]],
        attachments: dict[str, Attachment],
        metadata: dict[str, dict[str, str]],
        damage: tuple[str, ...],
    ) -> None:
        self.path = path
        self.topics = topics
        self.attachments = attachments
        self.metadata = metadata
        self.damage = damage
        """What is wrong with the file, in words; empty for a complete one."""

    @property
    def complete(self) -> bool:
        """True if the recorder finished the file and nothing in it is damaged."""
        return not self.damage

    def raw(self, topic: schemas.Topic) -> list[RawMessage]:
        """Messages of one topic, in the order of the file."""
        return self.topics.get(topic.name, [])

    def transitions(self) -> list[Transition]:
        """The state trace."""
        return self._decode(schemas.STATE, messages.decode_transition)

    def scanner_chunks(self, direction: Direction | None = None, *, coarse: bool = False) -> list[ScannerChunk]:
        """The serial line's bytes in both directions or one, in order of time; of the coarse scanner's if asked for."""
        chunks: list[ScannerChunk] = []
        topics = (schemas.COARSE_RX, schemas.COARSE_TX) if coarse else (schemas.SCANNER_RX, schemas.SCANNER_TX)
        sides: tuple[Direction, Direction] = ("rx", "tx")
        for side, topic in zip(sides, topics, strict=True):
            if direction in (None, side):
                chunks += [ScannerChunk(side, *parts) for parts in self._decode(topic, decode_scanner_bytes)]
        return sorted(chunks, key=lambda chunk: chunk.host_time_ns)

    def can_frames(self) -> list[CanFrame]:
        """CAN frames of both directions."""
        return self._decode(schemas.CAN, decode_can_frame)

    def arm_table(self) -> NDArray[np.void]:
        """All arm states as a structured array (N,), see ``recording_records.ARM_STATE``."""
        with self._guard(schemas.ARM):
            return arm_table([message.data for message in self.raw(schemas.ARM)])

    def arm_states(self) -> list[ArmState]:
        """All arm states as the driver's values."""
        return [arm_state(row) for row in self.arm_table()]

    def arm_commands(self) -> list[ArmCommandRecord]:
        """Calls to the arm."""
        return self._decode(schemas.ARM_COMMAND, messages.decode_arm_command)

    def decisions(self) -> list[Decision]:
        """What the safety gate said."""
        return self._decode(schemas.COMMAND, messages.decode_decision)

    def estimates(self) -> list[Located]:
        """Answers of the locator."""
        return self._decode(schemas.ESTIMATE, messages.decode_estimate)

    def scans(self) -> list[Scanned]:
        """Clouds of the finished sweeps."""
        with self._guard(schemas.POINTS):
            return [messages.decode_cloud(message.data, message.time_s) for message in self.raw(schemas.POINTS)]

    def contacts(self) -> list[Contacted]:
        """Contact numbers of each attempt."""
        return self._decode(schemas.CONTACT, messages.decode_contact)

    def links(self) -> list[LinkReport]:
        """Health of the links, as often as it was recorded."""
        return self._decode(schemas.LINK, messages.decode_link)

    def notes(self) -> list[Note]:
        """The mission's log."""
        with self._guard(schemas.LOG):
            return [messages.decode_note(message.data, message.time_s) for message in self.raw(schemas.LOG)]

    def waits(self) -> list[float]:
        """Times at which the mission stopped waiting for something."""
        return self._decode(schemas.WAIT, messages.decode_wait)

    def sweeps(self) -> list[SweepTaken]:
        """What each sweep was made of."""
        return self._decode(schemas.SWEEP, messages.decode_sweep)

    def drops(self) -> list[Drops]:
        """Samples that the recorder had to drop."""
        return self._decode(schemas.DROPS, messages.decode_drops)

    def summary(self) -> MissionSummary | None:
        """The mission's result; None if the recorder did not live to write it, or if it is damaged."""
        table = self.metadata.get("summary")
        try:
            return None if table is None else messages.decode_summary(table["json"])
        except (KeyError, TypeError, ValueError):  # metadata carries no checksum
            return None

    def _decode(self, topic: schemas.Topic, decode: Callable[[bytes], T]) -> list[T]:
        with self._guard(topic):
            return [decode(message.data) for message in self.raw(topic)]

    @contextmanager
    def _guard(self, topic: schemas.Topic) -> Iterator[None]:
        try:
            yield
        except (KeyError, TypeError, ValueError) as error:
            remedy = "Read it with the version of portdock that wrote it (portdock recording info says which)."
            raise RecordingFileError(f"{self.path}: cannot read topic {topic.name}: {error}", remedy=remedy) from error


def read_recording(path: Path) -> Recording:
    """Read all of a recording. Raises RecordingFileError if there is no such file or it is no recording."""
    found = _Found()
    for record in file_records(path, found.damage):
        found.add(record)
    topics: dict[str, list[RawMessage]] = defaultdict(list)
    for message in found.messages:
        # Channels are looked up last: when the chunk that declared them is damaged, the summary still names them.
        topic = found.channels.get(message.channel_id, f"channel {message.channel_id}")
        raw = RawMessage(message.log_time, message.publish_time, message.sequence, message.data)
        topics[topic].append(raw)
    if "recovery" in found.metadata:
        found.damage.append("recovered: " + found.metadata["recovery"].get("damage", ""))
    return Recording(path, dict(topics), found.attachments, found.metadata, tuple(found.damage))


class _Found:
    """What a pass over the file has collected."""

    def __init__(self) -> None:
        self.channels: dict[int, str] = {}
        self.messages: list[mcap_records.Message] = []
        self.attachments: dict[str, Attachment] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.damage: list[str] = []

    def add(self, record: mcap_records.McapRecord) -> None:
        match record:
            case mcap_records.Channel():
                self.channels[record.id] = record.topic
            case mcap_records.Message():
                self.messages.append(record)
            case mcap_records.Attachment():
                self.attachments[record.name] = Attachment(record.name, record.media_type, record.data)
            case mcap_records.Metadata():
                self.metadata[record.name] = dict(record.metadata)


def file_records(path: Path, damage: list[str]) -> Iterator[mcap_records.McapRecord]:
    """Records in the order of the file, chunks opened; what is wrong is appended to ``damage``."""
    try:
        stream = path.open("rb")
    except OSError as error:
        raise RecordingFileError(f"cannot read {path}: {error.strerror}") from error
    with stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise RecordingFileError(f"{path} is not an MCAP file")
        stream.seek(0)
        size = os.fstat(stream.fileno()).st_size
        for record in _until_damage(stream, size, damage):
            if not isinstance(record, mcap_records.Chunk):
                yield record
                continue
            try:
                yield from breakup_chunk(record, validate_crc=True)
            except Exception as error:  # a checksum that does not match, or whatever a decompressor makes of the bytes
                damage.append(f"a chunk of {record.uncompressed_size} bytes is damaged and left out ({error})")


_MAGIC = bytes([0x89]) + b"MCAP0\r\n"
# What the library raises for bytes that make no sense.
_BROKEN: tuple[type[Exception], ...] = (McapError, ValueError, RuntimeError, struct.error, OverflowError, MemoryError)


def _until_damage(stream: BinaryIO, size: int, damage: list[str]) -> Iterator[mcap_records.McapRecord]:
    reader: Any = StreamReader(stream, emit_chunks=True, record_size_limit=size)
    try:
        yield from reader.records
    except _BROKEN as error:
        damage.append(f"the file breaks off at byte {stream.tell()} of {size} ({type(error).__name__})")
