"""What can go wrong with a recording: begun in the wrong place, cut off while it is written, unreadable later."""

from __future__ import annotations

from typing import ClassVar

from perception.errors import InputError, PortdockError


class RecordingError(PortdockError):
    """The recording cannot be continued."""

    code: ClassVar[str] = "recording"
    default_remedy: ClassVar[str] = "Free disk space, or give a folder on another disk with --out."


class RecordingTargetError(InputError):
    """The recording cannot be begun where it was asked for."""

    code: ClassVar[str] = "recording-target"
    default_remedy: ClassVar[str] = "Give another, writable folder with --out."


class RecordingFileError(InputError):
    """A file is missing, or is not a recording of portdock, or what was asked for is not in it."""

    code: ClassVar[str] = "recording-file"
    default_remedy: ClassVar[str] = "Give the .mcap file of a mission."
