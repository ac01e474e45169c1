"""A recording's contents in the formats of other tools: candump and BLF for CAN, PLY for scans, CSV for the arm.

Times are the wall clock's where a format wants one (CAN logs), else seconds of the host's monotonic clock. Files are
written beside their place and moved there when complete.
"""

from __future__ import annotations

import contextlib
import enum
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import can
import numpy as np

from controller.recording import schemas
from controller.recording.errors import RecordingFileError
from controller.recording.reader import Recording
from controller.recording.records import ARM_STATE, decode_can_frame
from perception.cloud_write import ply_bytes
from perception.geometry import Array

_CAN_CHANNEL = "can0"


class ExportFormat(enum.StrEnum):
    """What to export, and how."""

    CANDUMP = "candump"
    BLF = "blf"
    PLY = "ply"
    CSV = "csv"


def export(recording: Recording, kind: ExportFormat, folder: Path) -> list[Path]:
    """Write one file (for scans one for each) into ``folder``, replacing older ones; returns what was written.

    Raises RecordingFileError if the recording holds nothing of the kind or the folder cannot be written.
    """
    files = _WRITERS[kind](recording)
    if not files:
        remedy = "portdock recording info shows what the recording holds."
        raise RecordingFileError(f"{recording.path} holds nothing to export as {kind}", remedy=remedy)
    stem = recording.path.stem
    return [_write(folder / f"{stem}{suffix}", writer) for suffix, writer in files]


Writer = Callable[[Path], None]


def _candump(recording: Recording) -> list[tuple[str, Writer]]:
    frames = _can_messages(recording)
    if not frames:
        return []
    return [("-can.log", lambda path: _write_frames(can.CanutilsLogWriter(path, channel=_CAN_CHANNEL), frames))]


def _blf(recording: Recording) -> list[tuple[str, Writer]]:
    frames = _can_messages(recording)
    if not frames:
        return []
    return [("-can.blf", lambda path: _write_frames(can.BLFWriter(path, channel=1), frames))]


def _ply(recording: Recording) -> list[tuple[str, Writer]]:
    scans = [ply_bytes(scanned.cloud.points, scanned.cloud.frame) for scanned in recording.scans()]
    return [(f"-scan-{number}.ply", partial(_write_bytes, data)) for number, data in enumerate(scans, 1)]


def _csv(recording: Recording) -> list[tuple[str, Writer]]:
    if not recording.raw(schemas.ARM):
        return []
    header, table = arm_columns(recording)
    return [("-arm.csv", lambda path: np.savetxt(path, table, "%.17g", ",", header=header, comments=""))]


_WRITERS: dict[ExportFormat, Callable[[Recording], list[tuple[str, Writer]]]] = {
    ExportFormat.CANDUMP: _candump,
    ExportFormat.BLF: _blf,
    ExportFormat.PLY: _ply,
    ExportFormat.CSV: _csv,
}


def _can_messages(recording: Recording) -> list[can.Message]:
    return [
        can.Message(
            timestamp=message.log_time_ns * 1e-9,
            arbitration_id=frame.arbitration_id,
            is_extended_id=frame.is_extended,
            is_error_frame=frame.is_error,
            is_fd=frame.is_fd,
            is_rx=frame.direction == "rx",
            data=frame.data,
            channel=_CAN_CHANNEL,
        )
        for message in recording.raw(schemas.CAN)
        for frame in (decode_can_frame(message.data),)
    ]


def _write_bytes(data: bytes, path: Path) -> None:
    path.write_bytes(data)


def _write_frames(writer: can.CanutilsLogWriter | can.BLFWriter, frames: list[can.Message]) -> None:
    with writer:
        for frame in frames:
            writer.on_message_received(frame)


def arm_columns(recording: Recording) -> tuple[str, Array]:
    """Header and (N, C) table of all arm states; vectors become numbered columns, rotations are row by row."""
    table = recording.arm_table()
    names: list[str] = []
    columns: list[Array] = []
    for field in ARM_STATE.fields:
        if field.name not in (table.dtype.names or ()):
            continue  # older recordings lack the last ones
        values = table[field.name].astype(np.float64).reshape(len(table), -1)
        names += [field.name] if values.shape[1] == 1 else [f"{field.name}_{k}" for k in range(values.shape[1])]
        columns.append(values)
    return ",".join(names), np.concatenate(columns, axis=1)


def _write(target: Path, writer: Writer) -> Path:
    unfinished = target.with_name(".part-" + target.name)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        writer(unfinished)
        os.replace(unfinished, target)
    except OSError as error:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        remedy = "Give another folder with --out."
        raise RecordingFileError(f"cannot write {target}: {error.strerror}", remedy=remedy) from error
    return target
