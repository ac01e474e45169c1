"""What a process that was killed left behind: recordings without an end are made complete, beside the original."""

from __future__ import annotations

import logging
from pathlib import Path

from controller.recording.file import is_being_written
from controller.recording.recovery import recover
from controller.session import RECORDING_NAME
from perception.errors import PortdockError

log = logging.getLogger(__name__)

MAGIC = b"\x89MCAP0\r\n"
RECOVERED_NAME = "mission-recovered.mcap"
MOST = 3
"""A start does not wait for more than the newest ones; `portdock recording recover` takes any."""


def recover_recordings(folder: Path) -> list[Path]:
    """Recover the newest damaged recordings in the subfolders of ``folder``; returns the new files. Never raises."""
    newest = sorted(folder.glob(f"*/{RECORDING_NAME}"), reverse=True)
    damaged = [path for path in newest if not (path.parent / RECOVERED_NAME).exists() and _has_no_end(path)]
    return [target for path in damaged[:MOST] if (target := _recovered(path)) is not None]


def _has_no_end(path: Path) -> bool:
    """Whether a recording lacks its closing magic and nobody is writing it."""
    try:
        with path.open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - len(MAGIC)))
            return file.read() != MAGIC and not is_being_written(path)
    except OSError:
        return False


def _recovered(path: Path) -> Path | None:
    target = path.parent / RECOVERED_NAME
    try:
        saved = recover(path, target)
    except PortdockError as error:
        log.warning("%s has no end and cannot be recovered: %s", path, error.cause)
        return None
    log.warning("%s had no end: %d messages saved in %s", path, saved.messages, target.name)
    return target
