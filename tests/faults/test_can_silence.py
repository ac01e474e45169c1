"""Heartbeats that stop, on either side: what the driver says, what the charger does, and how both come back."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from drivers.base import ChargerRequest, ChargerState, LinkLostError, PlugLock, RequestResult
from tests.contract.charger_bench import CLEAR, HOLDS_PLUG, PATIENT, QUICK, Bench, MockProcess

R = ChargerRequest
SILENCES = ("silent", "frozen", "stuck_counter", "damaged")


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


def _lost(bench: Bench) -> str:
    """What status says once it is lost; empty while it is not."""
    try:
        bench.charger.status()
    except LinkLostError as error:
        return error.cause
    return ""


@pytest.mark.parametrize("fault", SILENCES)
def test_a_charger_that_sends_nothing_new_is_lost_and_comes_back(mock: MockProcess, fault: str) -> None:
    bench = Bench(mock.fresh(), degraded_s=0.15, lost_s=0.25)
    try:
        bench.charger.open()
        mock.control(**{fault: True})
        bench.until(lambda: _lost(bench))
        assert not bench.charger.health().up
        last_s = bench.charger.health().last_rx_s
        assert last_s is not None
        assert time.monotonic() - last_s > 0.25, "not before its time"
        mock.control(**{fault: False})
        bench.until(lambda: not _lost(bench))
        counters = dict(bench.charger.health().counters)
        assert counters["losses"] >= 1
        suspect = {"frozen": "repeated", "stuck_counter": "repeated", "damaged": "bad_checksum"}.get(fault)
        assert suspect is None or counters[suspect] > 0
    finally:
        bench.close()


@pytest.mark.parametrize(
    ("fault", "words"), [("frozen", "repeats its last frame"), ("damaged", "checksums do not fit")]
)
def test_the_reason_of_a_loss_is_named(bench: Bench, fault: str, words: str) -> None:
    bench.charger.open()
    bench.mock.control(**{fault: True})
    bench.until(lambda: words in _lost(bench))


def test_two_chargers_under_one_identifier_are_not_believed(bench: Bench) -> None:
    bench.charge()
    bench.mock.control(twin=True)
    bench.until(lambda: "two nodes" in _lost(bench))
    bench.mock.control(twin=False)
    bench.until(lambda: not _lost(bench))
    assert bench.charger.status().state is ChargerState.CHARGING


def test_a_request_that_is_never_acknowledged_times_out_after_two_resends(bench: Bench) -> None:
    bench.welcome()
    bench.mock.control(mute=True)
    assert bench.ask(R.RESERVE) is RequestResult.TIMED_OUT
    assert dict(bench.charger.health().counters)["resent_requests"] == 2


def test_a_request_is_carried_through_a_short_deafness(bench: Bench) -> None:
    bench.welcome()
    number = bench.charger.request(R.RESERVE)
    bench.mock.control(mute=True)
    bench.until(lambda: dict(bench.charger.health().counters)["resent_requests"] == 1)
    bench.mock.control(mute=False)
    bench.until(lambda: bench.charger.result(number) is RequestResult.DONE)


def test_a_charger_that_restarts_fails_what_it_had_accepted(mock: MockProcess) -> None:
    slow = Bench(mock.fresh())
    try:
        slow.mate()
        number = slow.charger.request(R.ENABLE_POWER)
        slow.until(lambda: slow.charger.result(number) is RequestResult.ACCEPTED)
        mock.control(reboot=True)
        slow.until(lambda: slow.charger.result(number) is RequestResult.FAILED)
    finally:
        slow.close()


# --- the robot falls silent ---------------------------------------------------------------------------------------


def _fall_silent(bench: Bench) -> None:
    bench.beating = False


def test_before_power_a_silent_robot_gets_no_power_and_no_dock(bench: Bench) -> None:
    bench.mate()
    _fall_silent(bench)
    bench.until(lambda: bench.charger.status().motion_inhibit and not bench.charger.status().dock_enable)
    assert not bench.charger.status().contactor_closed
    bench.beating = True
    assert bench.ask(R.ENABLE_POWER) in (RequestResult.REJECTED, RequestResult.TIMED_OUT)
    assert bench.charger.status().motion_inhibit, "heard again is not reset"
    _tick(bench, 0.3)
    assert bench.charger.status().motion_inhibit
    bench.must(R.RESET_FAULT)
    bench.until(lambda: not bench.charger.status().motion_inhibit)


def test_a_silent_robot_that_holds_the_plug_stops_the_power_and_the_plug_stays_locked(bench: Bench) -> None:
    bench.charge()
    _fall_silent(bench)
    bench.until(lambda: bench.charger.status().state is ChargerState.FAULT)
    status = bench.charger.status()
    assert not status.contactor_closed
    bench.until(lambda: abs(bench.charger.status().current_a) < 5.0)  # measured every 100 ms only
    assert status.lock is PlugLock.LOCKED
    assert status.fault_code == 4
    bench.beating = True
    _tick(bench, 0.5)
    assert bench.charger.status().state is ChargerState.FAULT, "never resumed by itself"
    bench.must(R.RESET_FAULT, R.UNLOCK_PLUG)
    assert bench.charger.status().lock is PlugLock.UNLOCKED


def test_a_silent_robot_that_is_clear_leaves_the_charging_alone(bench: Bench) -> None:
    bench.charge()
    bench.flags = bench.flags & ~HOLDS_PLUG | CLEAR
    _tick(bench, 0.3)
    _fall_silent(bench)
    _tick(bench, 1.6)
    assert bench.charger.status().state is ChargerState.CHARGING
    assert bench.charger.status().motion_inhibit


# --- what the charger reports ---------------------------------------------------------------------------------------


def test_an_emergency_stop_is_reported_and_opens_the_contactor_at_once(bench: Bench) -> None:
    bench.charge()
    bench.mock.control(estop=True)
    bench.until(lambda: bench.charger.status().estop)
    assert bench.charger.status().state is ChargerState.ESTOP
    assert not bench.charger.status().contactor_closed
    assert bench.charger.status().lock is PlugLock.LOCKED
    assert bench.ask(R.RESET_FAULT) is RequestResult.REJECTED
    bench.mock.control(estop=False)
    bench.until(lambda: not bench.charger.status().estop)
    assert bench.charger.status().state is ChargerState.ESTOP
    bench.must(R.RESET_FAULT)


def test_a_welded_contactor_is_a_fault_and_the_plug_stays_locked(bench: Bench) -> None:
    bench.charge()
    bench.mock.control(contactor_welded=True)
    assert bench.ask(R.STOP_POWER) is RequestResult.FAILED
    status = bench.charger.status()
    assert status.state is ChargerState.FAULT
    assert status.contactor_closed
    assert bench.ask(R.UNLOCK_PLUG) is RequestResult.REJECTED
    assert bench.ask(R.RESET_FAULT) is RequestResult.REJECTED


def test_a_jammed_lock_fails_the_request_and_can_be_tried_again(bench: Bench) -> None:
    bench.welcome()
    bench.must(R.RESERVE, R.UNLOCK_DOCK)
    bench.mock.control(plugged=True, lock_jammed=True)
    bench.until(lambda: bench.charger.status().proximity == 1)
    assert bench.ask(R.LOCK_PLUG) is RequestResult.FAILED
    assert bench.charger.status().lock is PlugLock.FAULT
    bench.mock.control(lock_jammed=False)
    bench.must(R.UNLOCK_PLUG, R.LOCK_PLUG)


def test_a_plug_that_goes_while_power_is_on_is_a_fault(bench: Bench) -> None:
    bench.charge()
    bench.mock.control(plugged=False)
    bench.until(lambda: bench.charger.status().state is ChargerState.FAULT)
    assert bench.charger.status().fault_code == 5
    assert not bench.charger.status().contactor_closed


def test_an_overheated_contact_ends_the_charging(bench: Bench) -> None:
    bench.charge()
    bench.mock.control(temperature_c=120)
    bench.until(lambda: bench.charger.status().state is ChargerState.FAULT)
    assert bench.charger.status().fault_code == 6


def _tick(bench: Bench, seconds: float) -> None:
    end_s = time.monotonic() + seconds
    bench.until(lambda: time.monotonic() > end_s)
