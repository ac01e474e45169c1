"""Recorded time: it runs on demand, never back, and delivers everything in the order of its stamps."""

from __future__ import annotations

import pytest

from drivers.playback import EndOfRecording, Playback


def test_streams_are_delivered_together_in_order_of_time_and_at_their_time() -> None:
    playback, seen = Playback(0.0), []
    for name, times in (("a", (1.0, 3.0)), ("b", (2.0, 2.5))):
        playback.play((t, lambda n=name: seen.append((n, playback.now_s()))) for t in times)  # type: ignore[misc]
    playback.run_until(2.6)
    assert seen == [("a", 1.0), ("b", 2.0), ("b", 2.5)]
    assert playback.now_s() == 2.6


def test_time_never_goes_back() -> None:
    playback = Playback(5.0)
    playback.run_until(4.0)
    assert playback.now_s() == 5.0


def test_what_the_mission_does_again_happens_when_it_did() -> None:
    playback = Playback(0.0)
    playback.cue("decision", [1.0, 2.0])
    playback.did("decision")
    assert playback.now_s() == 1.0
    assert playback.next_cue_s() == 2.0


def test_more_than_was_recorded_ends_the_replay_past_every_handler_of_faults() -> None:
    playback = Playback(0.0)
    playback.cue("decision", [])
    with pytest.raises(EndOfRecording):
        playback.did("decision")
    assert not issubclass(EndOfRecording, Exception)


def test_cues_of_waits_that_are_over_are_skipped() -> None:
    playback = Playback(0.0)
    playback.cue("wait", [1.0, 2.0, 3.0])
    playback.skip_cues("wait", 2.5)
    assert playback.next_cue_s("wait") == 3.0
    playback.skip_cue("wait")
    playback.skip_cue("wait")
    assert playback.next_cue_s("wait") == float("inf")
