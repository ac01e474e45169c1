"""Every recording in this folder is replayed: a failure in the field becomes a test by copying its file here.

The recorded estimates are given, so that the controller and the drivers' decoding are what is tested, in seconds, and a
change of the locator does not make them differ. ``portdock replay FILE`` alone locates anew.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from controller.recording.reader import read_recording
from controller.replay.replay import replay

RECORDINGS = sorted(Path(__file__).parent.glob("*.mcap"))


def test_there_is_something_to_replay() -> None:
    assert RECORDINGS


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_the_controller_does_the_same_again(path: Path) -> None:
    result = replay(read_recording(path), recorded_estimates=True)
    assert result.difference is None, f"{path.name}: {result.difference} {result.ended}"
    assert result.states, "a replay of nothing proves nothing"
