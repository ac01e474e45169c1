"""The log goes into the recording without changing what is shown elsewhere."""

import io
import logging
from collections.abc import Iterator

import pytest

from controller.recording.log import log_into


class Notes:
    def __init__(self) -> None:
        self.taken: list[tuple[str, str]] = []

    def note(self, level: str, text: str) -> None:
        self.taken.append((level, text))


@pytest.fixture
def shown() -> Iterator[io.StringIO]:
    """A root logger as the command line sets it up: errors only."""
    root = logging.getLogger()
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    before = root.level
    root.addHandler(handler)
    root.setLevel(logging.ERROR)
    yield stream
    root.removeHandler(handler)
    root.setLevel(before)


def test_the_recording_takes_more_than_the_terminal_shows(shown: io.StringIO) -> None:
    notes, logger = Notes(), logging.getLogger("drivers.arm.ur")
    with log_into(notes):
        logger.debug("a detail")
        logger.info("connected to %s", "arm")
        logger.warning("late")
        logger.error("lost")
    assert notes.taken == [
        ("info", "drivers.arm.ur: connected to arm"),
        ("warning", "drivers.arm.ur: late"),
        ("error", "drivers.arm.ur: lost"),
    ]
    assert shown.getvalue() == "lost\n"


def test_afterwards_everything_is_as_before(shown: io.StringIO) -> None:
    notes, root = Notes(), logging.getLogger()
    before = (root.level, list(root.handlers), [handler.level for handler in root.handlers])
    with pytest.raises(RuntimeError), log_into(notes):
        raise RuntimeError
    assert (root.level, list(root.handlers), [handler.level for handler in root.handlers]) == before
    logging.getLogger("x").error("later")
    assert notes.taken == []


def test_a_broken_log_call_breaks_nothing(shown: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logging, "raiseExceptions", False)
    notes = Notes()
    with log_into(notes):
        logging.getLogger("x").error("%d", "no number")
        logging.getLogger("x").error("fine")
    assert notes.taken == [("error", "x: fine")]
