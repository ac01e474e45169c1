"""Keeps the folder of recordings below a size: the oldest missions go first, the newest one always stays."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass
from pathlib import Path

from controller.recording.file import is_being_written

logger = logging.getLogger(__name__)

_REPORT = "report.html"


@dataclass(frozen=True, slots=True)
class _Mission:
    """A recording and what lies beside it."""

    files: tuple[Path, ...]
    newest_s: float
    size: int


def prune(folder: Path, max_bytes: int) -> list[Path]:
    """Delete the oldest missions until recordings and reports take at most ``max_bytes``; returns what was deleted.

    Looks at ``folder`` and its direct subfolders only, follows no symbolic link, and touches nothing but a recording
    (``*.mcap``) and its report. A recording that is being written and the newest one are never deleted; a mission's own
    subfolder goes when it is empty. A file that cannot be deleted is logged and left.
    """
    missions = sorted(_missions(folder), key=lambda mission: mission.newest_s)
    total = sum(mission.size for mission in missions)
    deleted: list[Path] = []
    for mission in missions[:-1]:
        if total <= max_bytes:
            break
        if is_being_written(mission.files[0]):
            continue
        total -= mission.size
        deleted += _delete(mission, folder)
    return deleted


def _missions(folder: Path) -> list[_Mission]:
    recordings = [*folder.glob("*.mcap"), *folder.glob("*/*.mcap")]
    found: list[_Mission] = []
    for recording in recordings:
        if recording.is_symlink() or recording.parent.is_symlink() or not recording.is_file():
            continue
        reports = [recording.with_suffix(".html")]
        if recording.parent != folder:
            reports.append(recording.parent / _REPORT)
        files = (recording, *(report for report in reports if report.is_file() and not report.is_symlink()))
        with contextlib.suppress(FileNotFoundError):  # someone else deletes at the same time
            states = [file.stat() for file in files]
            found.append(_Mission(files, states[0].st_mtime, sum(state.st_size for state in states)))
    return found


def _delete(mission: _Mission, folder: Path) -> list[Path]:
    deleted: list[Path] = []
    for file in mission.files:
        try:
            file.unlink()
            deleted.append(file)
        except OSError as error:
            logger.warning("cannot delete the old recording %s: %s", file, error.strerror)
    home = mission.files[0].parent
    if home != folder:
        with contextlib.suppress(OSError):  # something else lies there: leave it
            home.rmdir()
    return deleted
