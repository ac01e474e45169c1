"""Requests, acknowledgements and silence, and what silence of status frames means."""

from __future__ import annotations

import pytest

from drivers.base import ChargerRequest, RequestResult
from drivers.charger.freshness import Freshness, Liveness
from drivers.charger.handshake import Handshake


@pytest.fixture
def handshake() -> Handshake:
    return Handshake(ack_timeout_s=0.5, resends=2, cycle_s=0.1)


def test_a_request_is_pending_until_it_is_acknowledged(handshake: Handshake) -> None:
    number = handshake.start(ChargerRequest.RESERVE, 0, 0.0)
    assert handshake.result(number, 0.1) is RequestResult.PENDING
    handshake.acknowledge(number, RequestResult.ACCEPTED)
    assert handshake.result(number, 10.0) is RequestResult.ACCEPTED
    handshake.acknowledge(number, RequestResult.DONE)
    assert handshake.result(number, 10.1) is RequestResult.DONE


@pytest.mark.parametrize("answer", [RequestResult.REJECTED, RequestResult.FAILED, RequestResult.DONE])
def test_an_end_is_an_end(handshake: Handshake, answer: RequestResult) -> None:
    number = handshake.start(ChargerRequest.LOCK_PLUG, 0, 0.0)
    handshake.acknowledge(number, answer)
    handshake.acknowledge(number, RequestResult.ACCEPTED)
    assert handshake.result(number, 0.2) is answer


def test_an_answer_to_another_number_counts_for_nothing(handshake: Handshake) -> None:
    number = handshake.start(ChargerRequest.RESERVE, 0, 0.0)
    handshake.acknowledge(number + 1, RequestResult.DONE)
    assert handshake.result(number, 0.1) is RequestResult.PENDING


def test_busy_stays_open(handshake: Handshake) -> None:
    number = handshake.start(ChargerRequest.UNLOCK_PLUG, 0, 0.0)
    handshake.acknowledge(number, RequestResult.BUSY)
    assert handshake.result(number, 0.1) is RequestResult.BUSY
    assert handshake.outgoing()[0] is ChargerRequest.UNLOCK_PLUG
    handshake.acknowledge(number, RequestResult.DONE)
    assert handshake.result(number, 0.2) is RequestResult.DONE


def test_without_an_answer_it_is_sent_again_twice_and_then_given_up(handshake: Handshake) -> None:
    number = handshake.start(ChargerRequest.RESERVE, 0, 0.0)
    sent = []
    for step in range(200):
        now_s = 0.01 * step
        if handshake.due(now_s):
            sent.append((round(now_s, 2), handshake.outgoing()[:2]))
            handshake.sent(now_s)
    assert handshake.resent == 2
    at_once = [time_s for time_s, _ in sent]
    assert 0.5 in at_once
    assert 1.0 in at_once
    assert handshake.result(number, 1.49) is RequestResult.TIMED_OUT
    assert {what for time_s, what in sent if time_s < 1.5} == {(ChargerRequest.RESERVE, number)}
    assert {what for time_s, what in sent if time_s > 1.5} == {(ChargerRequest.NONE, number)}


def test_time_runs_out_even_if_nobody_asks_what_is_due(handshake: Handshake) -> None:
    number = handshake.start(ChargerRequest.RESERVE, 0, 0.0)
    results = [handshake.result(number, t) for t in (0.4, 0.6, 1.2, 1.8)]
    assert results == [RequestResult.PENDING] * 3 + [RequestResult.TIMED_OUT]


def test_the_newest_request_is_repeated_every_cycle(handshake: Handshake) -> None:
    handshake.start(ChargerRequest.RESERVE, 0, 0.0)
    due = []
    for step in range(9):
        if handshake.due(0.05 * step):
            due.append(step)
            handshake.sent(0.05 * step)
    assert due == [0, 2, 4, 6, 8]


def test_a_newer_request_takes_the_place_of_an_open_one(handshake: Handshake) -> None:
    first = handshake.start(ChargerRequest.ENABLE_POWER, 16, 0.0)
    second = handshake.start(ChargerRequest.ABORT, 0, 0.1)
    assert handshake.result(first, 0.1) is RequestResult.FAILED
    assert handshake.outgoing() == (ChargerRequest.ABORT, second, 0)


def test_a_charger_that_forgot_an_accepted_request_has_failed_it(handshake: Handshake) -> None:
    number = handshake.start(ChargerRequest.LOCK_PLUG, 0, 0.0)
    handshake.acknowledge(number, RequestResult.ACCEPTED)
    handshake.acknowledge(0, RequestResult.PENDING)
    assert handshake.result(number, 0.2) is RequestResult.FAILED


def test_numbers_go_on_from_what_the_charger_remembers(handshake: Handshake) -> None:
    handshake.adopt(200)
    assert handshake.start(ChargerRequest.RESERVE, 0, 0.0) == 201
    handshake.adopt(7)
    assert handshake.start(ChargerRequest.RESERVE, 0, 0.0) == 202


def test_numbers_wrap_on_the_wire_only(handshake: Handshake) -> None:
    handshake.adopt(255)
    number = handshake.start(ChargerRequest.RESERVE, 0, 0.0)
    assert number == 256
    handshake.acknowledge(0, RequestResult.DONE)
    assert handshake.result(number, 0.1) is RequestResult.DONE


def test_a_number_that_was_never_given_out_is_an_error(handshake: Handshake) -> None:
    with pytest.raises(KeyError):
        handshake.result(5, 0.0)


@pytest.fixture
def freshness() -> Freshness:
    return Freshness(degraded_s=0.15, lost_s=0.25, recovery_frames=3)


def _beat(freshness: Freshness, *times_s: float) -> None:
    for time_s in times_s:
        freshness.good(time_s)


def test_silence_degrades_and_then_loses(freshness: Freshness) -> None:
    assert freshness.at(0.0) is Liveness.WAITING
    _beat(freshness, 1.0)
    assert freshness.at(1.15) is Liveness.ALIVE
    assert freshness.at(1.16) is Liveness.DEGRADED
    assert freshness.at(1.25) is Liveness.DEGRADED
    assert freshness.at(1.26) is Liveness.LOST


def test_three_good_frames_in_a_row_bring_it_back(freshness: Freshness) -> None:
    _beat(freshness, 1.0, 2.0)
    assert freshness.at(2.0) is Liveness.RECOVERING
    _beat(freshness, 2.05)
    assert freshness.at(2.05) is Liveness.RECOVERING
    _beat(freshness, 2.10)
    assert freshness.at(2.10) is Liveness.ALIVE


def test_a_bad_frame_in_between_starts_the_count_again(freshness: Freshness) -> None:
    _beat(freshness, 1.0, 2.0, 2.05)
    freshness.bad()
    _beat(freshness, 2.10, 2.15)
    assert freshness.at(2.15) is Liveness.RECOVERING
    _beat(freshness, 2.20)
    assert freshness.at(2.20) is Liveness.ALIVE


def test_a_loss_that_nobody_looked_at_still_counts(freshness: Freshness) -> None:
    _beat(freshness, 1.0, 1.4)
    assert freshness.at(1.4) is Liveness.RECOVERING
    assert freshness.losses == 1
