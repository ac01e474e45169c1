"""The driver's own decisions, frame by frame, with time in the test's hands and no bus."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.base import ChargerState, CommandRejectedError, Heartbeat, LinkLostError
from drivers.charger.can_charger import CanCharger
from drivers.charger.contract import Contract
from drivers.charger.settings import CanSettings

CONTRACT = Contract()
STATUS, ELECTRICAL = CONTRACT["CH_Status"], CONTRACT["CH_Electrical"]


class HandClock:
    """Time that a test sets."""

    def __init__(self) -> None:
        self.time_s = 100.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


class Hearing:
    """A driver that is handed frames."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.charger = CanCharger(CanSettings(channel="none"), self.clock)
        self.counter = 0

    def status(self, state: int = 1, counter: int | None = None, after_s: float = 0.05, code: int = 0) -> None:
        self.clock.time_s += after_s
        used = self.counter if counter is None else counter
        self.counter = (used + 1) % 15
        frame = STATUS.encode(used, State=state, FaultCode=code)
        self.charger._receive(STATUS.arbitration_id, frame, self.clock.time_s)

    @property
    def state(self) -> ChargerState | None:
        try:
            return self.charger.status().state
        except LinkLostError:
            return None


@pytest.fixture
def hearing() -> Hearing:
    hearing = Hearing()
    hearing.status()
    hearing.status()
    return hearing


def test_one_frame_is_not_yet_a_charger() -> None:
    hearing = Hearing()
    hearing.status()
    assert hearing.state is None
    hearing.status()
    assert hearing.state is ChargerState.IDLE


def test_a_replayed_frame_after_a_silence_does_not_count(hearing: Hearing) -> None:
    hearing.status(state=6, after_s=1.0)  # the counter would fit
    health = hearing.charger.health()
    assert health.last_rx_s == pytest.approx(hearing.clock.time_s - 1.0)
    hearing.status()
    assert hearing.charger.health().last_rx_s == pytest.approx(hearing.clock.time_s)


def test_after_a_loss_three_good_frames_are_needed_beyond_the_first(hearing: Hearing) -> None:
    states = []
    hearing.status(after_s=1.0)
    for _ in range(4):
        states.append(hearing.state)
        hearing.status()
    assert states == [None, None, None, ChargerState.IDLE]


def test_a_damaged_frame_starts_the_recovery_again(hearing: Hearing) -> None:
    hearing.status(after_s=1.0)
    hearing.status()
    hearing.status()
    hearing.charger._receive(STATUS.arbitration_id, bytes(8), hearing.clock.time_s)
    hearing.status()
    hearing.status()
    assert hearing.state is None
    hearing.status()
    assert hearing.state is ChargerState.IDLE


@pytest.mark.parametrize("gap_s", [0.05, 0.14, 0.24])
def test_a_late_frame_is_not_a_loss(hearing: Hearing, gap_s: float) -> None:
    hearing.clock.time_s += gap_s
    assert hearing.state is ChargerState.IDLE
    assert ("degraded" in hearing.charger.health().detail) == (gap_s > 0.15)
    hearing.status(after_s=0.0)
    counters = dict(hearing.charger.health().counters)
    assert (counters["late"], counters["losses"]) == (int(gap_s > 0.15), 0)


def test_a_lone_late_frame_does_not_refresh_an_old_status(hearing: Hearing) -> None:
    at_s = hearing.charger.status().time_s
    hearing.clock.time_s += 0.2
    assert hearing.charger.status().time_s == at_s


def test_electrical_values_are_nothing_until_measured(hearing: Hearing) -> None:
    status = hearing.charger.status()
    assert math.isnan(status.current_a)
    assert not status.current_a < 1.0, "no comparison with a limit holds"
    assert status.electrical_time_s == -math.inf
    for counter in (0, 1):
        frame = ELECTRICAL.encode(counter, Voltage=400.0, Current=12.0)
        hearing.charger._receive(ELECTRICAL.arbitration_id, frame, hearing.clock.time_s)
    assert hearing.charger.status().current_a == pytest.approx(12.0)
    assert hearing.charger.status().electrical_time_s == hearing.clock.time_s


def test_an_electrical_frame_alone_keeps_no_charger_alive(hearing: Hearing) -> None:
    for counter in range(10):
        hearing.clock.time_s += 0.1
        frame = ELECTRICAL.encode(counter, Voltage=400.0)
        hearing.charger._receive(ELECTRICAL.arbitration_id, frame, hearing.clock.time_s)
    assert hearing.state is None


def test_foreign_and_ill_fitting_frames_are_counted_and_dropped(hearing: Hearing) -> None:
    hearing.charger._receive(0x123, bytes(8), hearing.clock.time_s)
    hearing.charger._receive(STATUS.arbitration_id, bytes(7), hearing.clock.time_s)
    counters = dict(hearing.charger.health().counters)
    assert (counters["foreign_frames"], counters["bad_frames"]) == (1, 1)


def test_faults_are_told_from_reasons_of_a_refusal(hearing: Hearing) -> None:
    hearing.status(state=10, code=3)
    assert hearing.charger.status().fault_code == 3
    hearing.status(code=260)
    assert hearing.charger.status().fault_code == 0


def test_a_heartbeat_that_does_not_fit_is_refused_in_words(hearing: Hearing) -> None:
    with pytest.raises(CommandRejectedError, match="RC_Heartbeat"):
        hearing.charger.heartbeat(Heartbeat(mode=16, state=0, flags=0, cycle_id=0))


@pytest.mark.parametrize("cases", [10_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_a_damaged_frame_is_never_accepted(cases: int) -> None:
    """One or two flipped bits, a burst of up to eight, or a cut: whatever the frame said, it does not count."""
    rng = np.random.default_rng(7)
    hearing = Hearing()
    hearing.status(counter=0)
    incoming = hearing.charger._incoming
    for _ in range(cases):
        whole = STATUS.encode(1, State=rng.integers(12), Prox=rng.integers(5), AckSeq=rng.integers(256))
        assert not incoming.take(STATUS.arbitration_id, _damaged(whole, rng), hearing.clock.time_s)
    counters = incoming.counters()
    assert counters["bad_checksum"] + counters["bad_frames"] == cases
    assert incoming.status is None


def _damaged(frame: bytes, rng: np.random.Generator) -> bytes:
    kind = rng.integers(4)
    if kind == 0:
        return frame[: rng.integers(8)]
    if kind == 1:  # a burst inside the payload
        mask = int(rng.integers(1, 256)) << int(rng.integers(49))
    else:
        bits = rng.choice(64, size=kind - 1, replace=False)
        mask = sum(1 << int(bit) for bit in bits)
    return (int.from_bytes(frame, "big") ^ mask).to_bytes(8, "big")
