"""Keeps the folder of recordings below a size: the oldest missions go first, the newest one always stays."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass
from pathlib import Path

from controller.recording.file import is_being_written

logger = logging.getLogger(__name__)

CHARGER_LOSS_NAME = "charger-loss.log"
_BESIDE = ("report.html", CHARGER_LOSS_NAME)
"""What is written into a mission's own folder."""


@dataclass(frozen=True, slots=True)
class _Mission:
    """A recording and what lies beside it."""

    files: tuple[Path, ...]
    newest_s: float
    size: int


def prune(folder: Path, max_bytes: int, keep: Path | None = None) -> list[Path]:
    """Delete the oldest missions until recordings and reports take at most ``max_bytes``; returns what was deleted.

    Looks at ``folder`` and its direct subfolders only, follows no symbolic link, and touches nothing but a recording
    (``*.mcap``) and what portdock wrote beside it. A recording that is being written, the newest one and ``keep`` are
    never deleted (where the clock stands in the past another one seems the newest); a mission's own subfolder goes when
    it is empty. A file that cannot be deleted or looked at is logged or left.
    """
    missions = sorted(_missions(folder), key=lambda mission: mission.newest_s)
    total = sum(mission.size for mission in missions)
    deleted: list[Path] = []
    for mission in missions[:-1]:
        if total <= max_bytes:
            break
        if is_being_written(mission.files[0]) or (keep is not None and mission.files[0].resolve() == keep.resolve()):
            continue
        total -= mission.size
        deleted += _delete(mission, folder)
    return deleted


def _missions(folder: Path) -> list[_Mission]:
    recordings: list[Path] = []
    with contextlib.suppress(OSError):  # a disk that fails
        recordings = [*folder.glob("*.mcap"), *folder.glob("*/*.mcap")]
    found: list[_Mission] = []
    for recording in recordings:
        with contextlib.suppress(OSError):  # the same, or someone else deletes at the same time
            if not (recording.is_symlink() or recording.parent.is_symlink()) and recording.is_file():
                found.append(_mission(recording, folder))
    return found


def _mission(recording: Path, folder: Path) -> _Mission:
    beside = [recording.with_suffix(".html")]
    if recording.parent != folder:
        beside += [recording.parent / name for name in _BESIDE]
    files = (recording, *(file for file in beside if file.is_file() and not file.is_symlink()))
    states = [file.stat() for file in files]
    return _Mission(files, states[0].st_mtime, sum(state.st_size for state in states))


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
