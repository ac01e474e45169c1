"""Makes a complete recording of a damaged one: every record that can still be read, plus a new index and footer."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

from mcap import records as mcap_records
from mcap.writer import CompressionType, Writer

from controller.recording.errors import RecordingFileError
from controller.recording.file import LIBRARY
from controller.recording.reader import file_records

_CHUNK_BYTES = 128 * 1024


@dataclass(frozen=True, slots=True)
class Recovery:
    """What a recovery saved, and what was wrong with the file."""

    messages: int
    attachments: int
    damage: tuple[str, ...]


def recover(source: Path, target: Path) -> Recovery:
    """Copy what is readable from ``source`` to a new file ``target``, message by message, bytes and times unchanged.

    Raises RecordingFileError if the source is no recording or the target exists or cannot be written; a target that
    could not be finished is not left behind.
    """
    damage: list[str] = []
    declarations = list(_declarations(source))
    partial = target.with_name(target.name + ".part")
    try:
        if target.exists():
            raise FileExistsError(17, "the file exists already")
        with partial.open("wb") as stream:
            saved = _copy(
                source, Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD), declarations, damage
            )
            stream.flush()
            os.fsync(stream.fileno())
        partial.rename(target)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        remedy = "Give a new file in a writable folder with enough space."
        raise RecordingFileError(f"cannot write {target}: {error.strerror}", remedy=remedy) from error
    return Recovery(saved[0], saved[1], tuple(damage))


Declaration = mcap_records.Schema | mcap_records.Channel


def _declarations(source: Path) -> list[Declaration]:
    """Schemas and channels from anywhere in the file: the chunk that declared them may be the damaged one."""
    found: dict[tuple[str, int], Declaration] = {}
    for record in file_records(source, []):
        if isinstance(record, Declaration):
            found.setdefault((type(record).__name__, record.id), record)
    return [found[key] for key in sorted(found, reverse=True)]  # "Schema" before "Channel"


def _copy(source: Path, writer: Writer, declarations: list[Declaration], damage: list[str]) -> tuple[int, int]:
    """Numbers of messages and attachments copied."""
    writer.start(library=LIBRARY)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for declared in declarations:
        if isinstance(declared, mcap_records.Schema):
            schemas[declared.id] = writer.register_schema(declared.name, declared.encoding, declared.data)
        else:
            schema = schemas.get(declared.schema_id, 0)
            channels[declared.id] = writer.register_channel(declared.topic, declared.message_encoding, schema)
    messages = attachments = 0
    for record in file_records(source, damage):
        match record:
            case mcap_records.Message() if record.channel_id in channels:
                _copy_message(writer, record, channels[record.channel_id])
                messages += 1
            case mcap_records.Attachment(create_time, log_time, name, media_type, data):
                writer.add_attachment(create_time, log_time, name, media_type, data)
                attachments += 1
            case mcap_records.Metadata():
                writer.add_metadata(record.name, dict(record.metadata))
    if damage:
        writer.add_metadata("recovery", {"source": source.name, "damage": "; ".join(damage)})
    writer.finish()  # type: ignore[no-untyped-call]
    return messages, attachments


def _copy_message(writer: Writer, message: mcap_records.Message, channel: int) -> None:
    writer.add_message(channel, message.log_time, message.data, message.publish_time, message.sequence)
