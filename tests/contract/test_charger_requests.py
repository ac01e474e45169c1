"""The hand-shake of every request over the wire: done, refused with a reason, sent again, given up."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from drivers.base import ChargerRequest, ChargerState, RequestResult
from tests.contract.charger_bench import PATIENT, QUICK, Bench, MockProcess

R = ChargerRequest
NAMES = {
    R.RESERVE: "Reserve", R.UNLOCK_DOCK: "UnlockDock", R.LOCK_PLUG: "LockPlug", R.ENABLE_POWER: "EnablePower",
    R.STOP_POWER: "StopPower", R.UNLOCK_PLUG: "UnlockPlug", R.RELEASE: "Release", R.RESET_FAULT: "ResetFault",
    R.ABORT: "Abort",
}  # fmt: skip
"""All nine, as the DBC calls them."""


def _reserved(bench: Bench) -> None:
    bench.welcome()
    bench.must(R.RESERVE)


def _plugged(bench: Bench) -> None:
    _reserved(bench)
    bench.must(R.UNLOCK_DOCK)
    bench.mock.control(plugged=True)
    bench.until(lambda: bench.charger.status().proximity == 1)


def _charged(bench: Bench) -> None:
    bench.charge()
    bench.must(R.STOP_POWER)
    bench.until(lambda: abs(bench.charger.status().current_a) < 1.0)


def _stopped(bench: Bench) -> None:
    bench.welcome()
    bench.mock.control(estop=True)
    bench.until(lambda: bench.charger.status().estop)
    bench.mock.control(estop=False)
    bench.until(lambda: not bench.charger.status().estop)


def _mute(bench: Bench) -> None:
    """No more acknowledgements. Its next words but one show that it has been told."""
    bench.mock.control(mute=True)
    ok = dict(bench.charger.health().counters)["ok"]
    bench.until(lambda: dict(bench.charger.health().counters)["ok"] >= ok + 4)


PREPARED: dict[ChargerRequest, Callable[[Bench], None]] = {
    R.RESERVE: Bench.welcome,
    R.UNLOCK_DOCK: _reserved,
    R.LOCK_PLUG: _plugged,
    R.ENABLE_POWER: Bench.mate,
    R.STOP_POWER: Bench.charge,
    R.UNLOCK_PLUG: _charged,
    R.RELEASE: _reserved,
    R.RESET_FAULT: _stopped,
    R.ABORT: Bench.charge,
}
AFTER = {
    R.RESERVE: ChargerState.RESERVED, R.UNLOCK_DOCK: ChargerState.READY, R.LOCK_PLUG: ChargerState.READY,
    R.ENABLE_POWER: ChargerState.CHARGING, R.STOP_POWER: ChargerState.FINISHED, R.UNLOCK_PLUG: ChargerState.FINISHED,
    R.RELEASE: ChargerState.IDLE, R.RESET_FAULT: ChargerState.IDLE, R.ABORT: ChargerState.FINISHED,
}  # fmt: skip


@pytest.fixture(scope="module")
def mock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MockProcess]:
    mock = MockProcess(tmp_path_factory.mktemp("bus"), PATIENT, QUICK)
    yield mock
    assert mock.stop() == 0


@pytest.fixture
def bench(mock: MockProcess) -> Iterator[Bench]:
    bench = Bench(mock.fresh())
    yield bench
    bench.close()


def test_these_are_all_requests() -> None:
    assert set(NAMES) | {R.NONE} == set(R)


@pytest.mark.parametrize("request_", NAMES, ids=NAMES.values())
def test_it_is_acknowledged_by_its_number_and_done(bench: Bench, request_: ChargerRequest) -> None:
    PREPARED[request_](bench)
    number = bench.charger.request(request_)
    bench.until(lambda: bench.charger.result(number) is RequestResult.DONE)
    assert bench.charger.status().state is AFTER[request_]
    assert bench.charger.refusal() == ""


@pytest.mark.parametrize("request_", NAMES, ids=NAMES.values())
def test_a_refusal_comes_with_its_reason_and_changes_nothing(bench: Bench, request_: ChargerRequest) -> None:
    PREPARED[request_](bench)
    before = bench.charger.status().state
    bench.mock.control(reject=NAMES[request_])
    assert bench.ask(request_) is RequestResult.REJECTED
    assert bench.charger.status().state is before
    if bench.charger.status().fault_code == 0:
        assert bench.charger.refusal() == "WrongState"
    bench.must(request_)  # asked again, with a new number


@pytest.mark.parametrize("request_", NAMES, ids=NAMES.values())
def test_unanswered_it_is_sent_again_and_an_answer_that_comes_late_counts(
    bench: Bench, request_: ChargerRequest
) -> None:
    PREPARED[request_](bench)
    resent = dict(bench.charger.health().counters)["resent_requests"]
    _mute(bench)
    number = bench.charger.request(request_)
    bench.until(lambda: dict(bench.charger.health().counters)["resent_requests"] == resent + 1)
    assert bench.charger.result(number) is RequestResult.PENDING
    bench.mock.control(mute=False)
    bench.until(lambda: bench.charger.result(number) is RequestResult.DONE)


@pytest.mark.parametrize("request_", NAMES, ids=NAMES.values())
def test_never_answered_it_is_given_up_after_two_resends(mock: MockProcess, request_: ChargerRequest) -> None:
    bench = Bench(mock.fresh())
    try:
        PREPARED[request_](bench)
        bench.charger._outgoing.handshake._ack_timeout_s = 0.1  # the preparation had its full time
        resent = dict(bench.charger.health().counters)["resent_requests"]
        _mute(bench)
        assert bench.ask(request_) is RequestResult.TIMED_OUT
        assert dict(bench.charger.health().counters)["resent_requests"] == resent + 2
    finally:
        bench.close()
