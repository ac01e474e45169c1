"""The program's own log as part of the recording: what drivers and controller reported while the mission ran."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from controller.recording.values import Level


class NoteTaker(Protocol):
    """What a recorder offers here."""

    def note(self, level: Level, text: str) -> None: ...


class RecordingLogHandler(logging.Handler):
    """Hands every log record to a recorder; never raises, never waits."""

    def __init__(self, recorder: NoteTaker, level: int = logging.INFO) -> None:
        super().__init__(level)
        self._recorder = recorder

    def emit(self, record: logging.LogRecord) -> None:
        """One record as one note, with the name of the module that reported it."""
        try:
            self._recorder.note(_level(record.levelno), f"{record.name}: {record.getMessage()}")
        except Exception:  # a broken log call must not break what it reports on; logging shows it on stderr
            self.handleError(record)


@contextmanager
def log_into(recorder: NoteTaker, level: int = logging.INFO) -> Iterator[None]:
    """While inside, everything logged at ``level`` or above also goes into the recording.

    What the other handlers show stays as it was, even where the recording takes more than they do.
    """
    root = logging.getLogger()
    shown, handlers = root.level, list(root.handlers)
    own_levels = [handler.level for handler in handlers]
    recording = RecordingLogHandler(recorder, level)
    for handler in handlers:
        handler.setLevel(max(handler.level, shown))
    root.addHandler(recording)
    root.setLevel(min(shown, level))
    try:
        yield
    finally:
        root.removeHandler(recording)
        root.setLevel(shown)
        for handler, own_level in zip(handlers, own_levels, strict=True):
            handler.setLevel(own_level)


def _level(number: int) -> Level:
    if number >= logging.CRITICAL:
        return "fatal"
    if number >= logging.ERROR:
        return "error"
    if number >= logging.WARNING:
        return "warning"
    return "info" if number >= logging.INFO else "debug"
