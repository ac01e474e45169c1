"""A replay's waits are matched with the recorded ones by order; what is a little late is looked for again at once."""

from __future__ import annotations

import pytest

from controller.config import load_config
from controller.faults import FaultCode
from controller.recording.values import Transition
from controller.replay.evidence import STATE, WAIT
from controller.replay.story import Asked, Story
from controller.replay.ticking import ReplaySupervisor
from controller.sources import Sources
from controller.states import Event, State
from controller.supervisor import StopRequested
from controller.task import Goal
from drivers.playback import ARM, EndOfRecording, Playback
from tests.unit.mission_rig import StandInArm, StandInCharger, StandInScanner


def supervisor(
    waits_s: list[float], asked: tuple[Asked, ...] = (), state: State = State.OFFLINE, first: Event = Event.STARTED
) -> tuple[ReplaySupervisor, Playback]:
    config, playback = load_config(), Playback(0.0)
    playback.cue(WAIT, waits_s)
    story = Story(config, 1.0, Goal.CYCLE, state, first, b"", 0.0, asked, "", 0.0, 100.0, True)
    arm = StandInArm(config.port.T_base_port.pose)
    sources = Sources(arm, StandInCharger(arm), StandInScanner())
    return ReplaySupervisor(sources, playback, playback, 0.5, story), playback


def test_a_wait_ends_when_the_recorded_one_did() -> None:
    waiting, playback = supervisor([1.0, 2.0])
    assert waiting.wait(lambda: playback.now_s() >= 0.3)
    assert playback.now_s() == 1.0
    assert waiting.wait(lambda: True)
    assert playback.now_s() == 2.0


def test_the_wait_for_work_is_not_in_the_recording_that_the_work_began() -> None:
    waiting, playback = supervisor([1.0, 2.0], state=State.READY)
    assert waiting.wait(lambda: True)
    assert playback.now_s() == 0.0
    assert waiting.wait(lambda: True)
    assert playback.now_s() == 1.0


def test_a_charge_that_ended_has_no_wait_at_rest() -> None:
    waiting, playback = supervisor([1.0, 2.0], state=State.CHARGING, first=Event.CHARGE_COMPLETE)
    assert waiting.wait(lambda: True)
    assert playback.now_s() == 1.0


def test_a_rest_that_was_not_over_at_once_is_over_all_the_same() -> None:
    waiting, playback = supervisor([1.0, 2.0], state=State.CHARGING)
    assert waiting.wait(lambda: playback.now_s() >= 0.3)
    assert playback.now_s() == 1.0
    assert waiting.wait(lambda: True)
    assert playback.now_s() == 2.0


def test_ticks_that_are_waited_for_do_not_run_past_the_wait_after_them() -> None:
    """Recorded ticks may have come early: three of them took 28 ms, not 30, and two waits ended within the rest."""
    waiting, playback = supervisor([0.0281, 0.0282, 5.0])
    waiting.wait_ticks(3)
    assert playback.now_s() == 0.0281
    waiting.wait(lambda: True)
    waiting.wait(lambda: True)
    assert playback.now_s() == 0.0282


def test_a_wait_that_takes_a_little_longer_leaves_the_next_ones_end_to_the_next() -> None:
    waiting, playback = supervisor([1.0, 1.002, 3.0])
    assert waiting.wait(lambda: playback.now_s() >= 1.0045)
    assert playback.now_s() == pytest.approx(1.005), "looked again each millisecond"
    assert waiting.wait(lambda: True)
    assert playback.now_s() == pytest.approx(1.005), "that is over, the time does not go back"
    assert waiting.wait(lambda: True)
    assert playback.now_s() == 3.0


def test_what_is_known_long_before_the_recorded_end_is_not_waited_for() -> None:
    waiting, playback = supervisor([10.0, 11.0])
    assert waiting.wait(lambda: True)
    assert playback.now_s() == 0.0
    assert playback.next_cue_s(WAIT) == 11.0


def test_a_wait_for_what_never_comes_ends_the_replay() -> None:
    waiting, playback = supervisor([1.0])
    with pytest.raises(EndOfRecording, match="goes on waiting"):
        waiting.wait(lambda: False)
    assert playback.now_s() > 10.0


def test_a_wait_that_was_broken_off_in_the_recording_is_not_over_before() -> None:
    """What it waits for is there at once here; there, the stop came first."""
    waiting, playback = supervisor([2.0], (Asked(0.5, abort=False),))
    playback.cue(STATE, [0.6])
    waiting.enter(State.STAGING, None)
    with pytest.raises(StopRequested):
        waiting.wait(lambda: True)
    assert playback.now_s() < 0.6


def test_where_the_mission_tripped_before_it_did_anything_else_time_passes_until_it_does_here() -> None:
    waiting, playback = supervisor([], (Asked(0.5, abort=True),))
    playback.cue(STATE, [0.6])
    waiting.enter(State.STAGING, None)
    assert waiting.trip is None
    assert playback.now_s() == 0.0, "no fault is coming: no time passes"
    waiting.coming_fault = lambda: Transition(0.6, "STAGING", "abort requested", "FAULT", 0.6)
    assert waiting.trip is not None
    assert waiting.trip.code is FaultCode.ABORTED
    assert 0.5 <= playback.now_s() < 0.6


@pytest.mark.parametrize(("stop_s", "meanwhile"), [(0.4, True), (0.8, False)], ids=["before FAULT", "after"])
def test_a_motion_is_stopped_once_more_only_where_the_recorded_one_was_before_the_fault(
    stop_s: float, meanwhile: bool
) -> None:
    waiting, playback = supervisor([], (Asked(0.3, abort=True),))
    playback.cue(STATE, [0.5])
    playback.cue(ARM, [stop_s])
    waiting.coming_fault = lambda: Transition(0.5, "STAGING", "abort requested", "FAULT", 0.5)
    assert waiting.tripped_meanwhile is meanwhile
    assert (playback.now_s() > 0.0) is meanwhile, "only then time passes, until the trip has come here too"
