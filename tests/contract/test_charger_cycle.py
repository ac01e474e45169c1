"""What any charger behind the CAN driver must do, held against the mock charger's process over its pty."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

from drivers.base import (
    ChargerRequest,
    ChargerState,
    CommandRejectedError,
    DockPose,
    Pilot,
    PlugLock,
    Proximity,
    RequestResult,
)
from drivers.charger.contract import bundled_dbc
from drivers.charger.e2e import Scheme
from mocks.world.blackboard import Blackboard, PlugState
from perception.geometry import Pose
from tests.contract.charger_bench import MATED, PATIENT, QUICK, Bench, MockProcess, drain, tap

R = ChargerRequest
DATABASE: Any = cantools.database.load_file(bundled_dbc())


@pytest.fixture(scope="module")
def mock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MockProcess]:
    mock = MockProcess(tmp_path_factory.mktemp("bus"), PATIENT, QUICK, taps=1)
    yield mock
    assert mock.stop() == 0


@pytest.fixture
def bench(mock: MockProcess) -> Iterator[Bench]:
    bench = Bench(mock.fresh())
    yield bench
    bench.close()


def test_a_whole_charging_session(bench: Bench) -> None:
    charger = bench.charger
    charger.open()
    assert charger.status().motion_inhibit, "nobody has heard the robot yet"
    bench.until(lambda: not charger.status().motion_inhibit)
    bench.until(lambda: charger.status().state is ChargerState.IDLE)
    assert charger.status().pilot is Pilot.A

    bench.must(R.RESERVE, R.UNLOCK_DOCK)
    assert charger.status().state is ChargerState.READY
    assert charger.status().dock_enable

    bench.mock.control(plugged=True)
    bench.until(lambda: charger.status().proximity is Proximity.INSERTED)
    bench.must(R.LOCK_PLUG)
    assert charger.status().lock is PlugLock.LOCKED
    assert charger.status().proximity is Proximity.LATCHED
    assert not charger.status().motion_inhibit, "the robot still holds the seating force"

    bench.flags |= MATED
    bench.must(R.ENABLE_POWER)
    assert charger.status().contactor_closed
    bench.until(lambda: charger.status().current_a > 100.0)
    assert charger.status().state is ChargerState.CHARGING
    assert charger.status().pilot is Pilot.C
    assert charger.status().motion_inhibit
    assert charger.status().voltage_v == pytest.approx(400, abs=20)

    bench.must(R.STOP_POWER)
    assert not charger.status().contactor_closed
    bench.until(lambda: abs(charger.status().current_a) < 1.0)
    bench.must(R.UNLOCK_PLUG)
    assert charger.status().lock is PlugLock.UNLOCKED
    assert not charger.status().motion_inhibit
    bench.mock.control(plugged=False)
    bench.until(lambda: charger.status().proximity is Proximity.ABSENT)
    bench.must(R.RELEASE)
    assert charger.status().state is ChargerState.IDLE
    counters = dict(charger.health().counters)
    assert counters["bad_checksum"] == counters["repeated"] == counters["losses"] == 0


def test_requests_out_of_order_are_refused_with_a_reason(bench: Bench) -> None:
    bench.welcome()
    assert bench.ask(R.UNLOCK_DOCK) is RequestResult.REJECTED
    assert bench.charger.refusal() == "WrongState"
    assert bench.charger.status().fault_code == 0, "a refusal is not a fault"
    bench.must(R.RESERVE, R.UNLOCK_DOCK)
    assert bench.ask(R.LOCK_PLUG) is RequestResult.REJECTED
    assert bench.charger.refusal() == "NoPlug"
    assert bench.ask(R.ENABLE_POWER) is RequestResult.REJECTED


def test_power_is_refused_until_the_robot_says_that_the_plug_is_mated(bench: Bench) -> None:
    bench.mate()
    bench.flags &= ~MATED
    assert bench.ask(R.ENABLE_POWER) is RequestResult.REJECTED
    assert bench.charger.refusal() == "NotMated"
    bench.flags |= MATED
    bench.must(R.ENABLE_POWER)  # at once: the heartbeat that says so goes out before the request


def test_the_plug_stays_locked_while_power_is_on(bench: Bench) -> None:
    bench.charge()
    assert bench.ask(R.UNLOCK_PLUG) is RequestResult.REJECTED
    assert bench.charger.refusal() == "PowerNotOff"
    assert bench.charger.status().lock is PlugLock.LOCKED


def test_a_current_limit_is_kept(bench: Bench) -> None:
    bench.mate()
    assert bench.ask(R.ENABLE_POWER, 32) is RequestResult.DONE
    bench.until(lambda: bench.charger.status().current_a == pytest.approx(32.0))
    seen = []
    bench.until(lambda: seen.append(bench.charger.status().current_a) or len(seen) > 50)
    assert max(seen) == pytest.approx(32.0)


def test_abort_stops_power_and_keeps_the_plug_locked(bench: Bench) -> None:
    bench.charge()
    bench.must(R.ABORT)
    assert not bench.charger.status().contactor_closed
    assert bench.charger.status().lock is PlugLock.LOCKED


def test_an_argument_that_does_not_fit_is_refused_here(bench: Bench) -> None:
    bench.charger.open()
    with pytest.raises(CommandRejectedError):
        bench.charger.request(R.ENABLE_POWER, 70_000)
    with pytest.raises(CommandRejectedError):
        bench.charger.result(12345)


def test_nothing_is_sent_unless_the_tick_calls(bench: Bench) -> None:
    with tap(bench.mock.taps[0]) as bus:
        bench.charger.open()
        bench.charger.publish(_pose())
        bench.charger.request(R.RESERVE)
        assert not [m for m in drain(bus, 0.4) if m.arbitration_id & 0xFF == 0xB0]
        bench.until(lambda: not bench.charger.status().motion_inhibit)
        assert [m for m in drain(bus, 0.1) if m.arbitration_id & 0xFF == 0xB0]


def test_a_pose_goes_out_as_position_rotation_quality_with_one_sequence_number(bench: Bench) -> None:
    bench.welcome()
    with tap(bench.mock.taps[0]) as bus:
        heard = PoseTap(bus)
        bench.charger.publish(_pose())
        bench.until(lambda: len(heard.groups()) >= 3)
        for names, sequences, values in heard.groups():
            assert names == ["RC_DockPos", "RC_DockRot", "RC_DockQuality"]
            assert len(set(sequences)) == 1
            assert values["X"] == pytest.approx(812.35)
            assert values["RY"] == pytest.approx(-0.2)
            assert values["Valid"] == 1
        first = heard.groups()[-1][1][0]
        bench.charger.publish(None)
        bench.until(heard.withdrawn)
        _tick_for(bench, 0.7)
        said = len(heard.withdrawn())
        assert 1 <= said <= 3, "said three times; a bus that stalls takes only the newest"
        _tick_for(bench, 0.3)
        assert len(heard.withdrawn()) == said, "then silent"
        assert heard.groups()[-1][1][0] == (first + 1) % 16


def test_an_impossible_pose_is_refused_and_withdrawn(bench: Bench) -> None:
    bench.welcome()
    bench.charger.publish(_pose())
    with pytest.raises(CommandRejectedError, match="finite"):
        bench.charger.publish(_pose(x=float("nan")))
    with tap(bench.mock.taps[0]) as bus:
        heard = PoseTap(bus)
        bench.until(heard.withdrawn)
        assert len(heard.groups()) == len(heard.withdrawn())


def test_the_recorder_gets_every_frame_of_both_directions(bench: Bench) -> None:
    bench.welcome()
    bench.must(R.RESERVE)
    frames = bench.log.frames
    assert {f.arbitration_id for f in frames if f.direction == "tx"} == {0x0CFF10B0, 0x0CFF11B0}
    assert {f.arbitration_id for f in frames if f.direction == "rx"} == {0x0CFF2056, 0x18FF2156}
    assert all(len(f.data) == 8 and f.is_extended and not f.is_error for f in frames)
    counters = [f.data[1] & 0x0F for f in frames if f.arbitration_id == 0x0CFF10B0]
    assert counters == [k % 15 for k in range(len(counters))]


def test_a_second_controller_is_understood_from_its_first_request(bench: Bench) -> None:
    bench.welcome()
    bench.must(R.RESERVE)
    bench.charger.close()
    bench.charger.__init__(bench.settings, bench.charger._clock, bench.log)  # type: ignore[misc]
    bench.welcome()
    bench.must(R.RELEASE)
    assert bench.charger.status().state is ChargerState.IDLE, "not taken for a repeat of the first one's request"


def test_closing_twice_and_before_opening_does_no_harm(bench: Bench) -> None:
    bench.charger.close()
    bench.charger.open()
    bench.charger.close()
    bench.charger.close()


def test_the_plug_is_sensed_and_locked_in_the_mocks_shared_world(tmp_path: Path) -> None:
    board = Blackboard.create(tmp_path, time_scale=10.0)
    mock = MockProcess(tmp_path, PATIENT, f"--world={tmp_path}")
    bench = Bench(mock)
    try:
        bench.welcome()
        bench.must(R.RESERVE, R.UNLOCK_DOCK)
        board.put_plug(PlugState(0.03, 0.0, 0.0, 0.0, True, 40.0))
        bench.until(lambda: bench.charger.status().proximity is Proximity.INSERTED)
        assert not board.lock()
        bench.must(R.LOCK_PLUG)
        assert board.lock()
        board.put_estop(True)
        bench.until(lambda: bench.charger.status().estop)
        assert bench.charger.status().state is ChargerState.ESTOP
    finally:
        bench.close()
        mock.stop()
        board.close()


@pytest.mark.parametrize("protection", ["none", "counter", "j1850", "e2e-p5"])
def test_other_protections_work_too(tmp_path: Path, protection: str) -> None:
    fd = ["--fd"] if protection == "e2e-p5" else []
    mock = MockProcess(tmp_path, PATIENT, f"--protection={protection}", *fd)
    bench = Bench(mock, protection=Scheme(protection))
    try:
        bench.welcome()
        bench.must(R.RESERVE)
        assert ("not protected" in bench.charger.health().detail) == (protection == "none")
    finally:
        bench.close()
        mock.stop()


def _pose(x: float = 0.81235) -> DockPose:
    T_base_port = Pose.from_rotvec((0.1, -0.2, 0.3), np.array([x, -0.1, 0.65]))
    return DockPose(T_base_port, 0.00015, 0.93, 0.001, time.monotonic())


def _tick_for(bench: Bench, seconds: float) -> None:
    end_s = time.monotonic() + seconds
    bench.until(lambda: time.monotonic() > end_s)


class PoseTap:
    """The pose frames that another host on the bus hears, in threes."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._heard: list[tuple[str, dict[str, Any]]] = []

    def groups(self) -> list[tuple[list[str], list[int], dict[str, Any]]]:
        """Names, sequence numbers and all values of each complete group so far."""
        while (message := self._bus.recv(0)) is not None:
            known = DATABASE.get_message_by_frame_id(message.arbitration_id)
            if known.name.startswith("RC_Dock"):
                self._heard.append((known.name, known.decode(message.data, decode_choices=False)))
        groups = []
        for k in range(0, len(self._heard) - 2, 3):
            three = self._heard[k : k + 3]
            values = {key: value for _, part in three for key, value in part.items()}
            groups.append(
                ([name for name, _ in three], [int(values[k]) for k in ("PosSeq", "RotSeq", "QualSeq")], values)
            )
        return groups

    def withdrawn(self) -> list[dict[str, Any]]:
        """The groups that say there is no pose."""
        return [values for _, _, values in self.groups() if values["Valid"] == 0]
