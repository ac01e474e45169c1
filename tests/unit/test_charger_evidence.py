"""What is kept of a lost charger, what wakes the supervisor, and links that nobody may use by mistake."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import controller.supervisor
from controller.charger_config import check_can_protection
from controller.config import parse_config
from controller.config_section import ConfigError
from controller.recording.candump import candump_text
from controller.recording.reader import read_recording
from controller.recording.recorder import Recorder
from controller.recording.ring import CHARGER_LOSS_NAME
from controller.session import keep_charger_loss
from controller.sources import Sources
from controller.supervisor import Supervisor
from controller.wiring import build_devices
from drivers.base import CanFrame, ChargerState, LinkLostError, MonotonicClock, NullSink
from drivers.charger.can_charger import CanCharger
from drivers.charger.e2e import Scheme
from drivers.charger.settings import CanSettings
from drivers.charger.tail import TrafficTail
from drivers.charger.traffic import CanTraffic, listen_to_file
from tests.unit.mission_rig import Rig
from tests.unit.test_charger_driver import CONTRACT, ELECTRICAL, STATUS, Hearing


def _frame(time_s: float, data: bytes = bytes(8)) -> CanFrame:
    return CanFrame(time_s, "rx", STATUS.arbitration_id, data)


# --- the last seconds -------------------------------------------------------------------------------------------------


def test_a_tail_keeps_what_is_young_enough() -> None:
    tail = TrafficTail(2.0)
    for k in range(100):
        tail.add(_frame(0.1 * k))
    assert [round(frame.time_s, 1) for frame in tail.since(9.0)] == [round(9.0 + 0.1 * k, 1) for k in range(10)]
    assert len(tail.since(-1.0)) == 21
    assert tail.since(50.0) == ()


def test_a_flood_does_not_eat_the_memory() -> None:
    tail = TrafficTail(1e9)
    for k in range(30_000):
        tail.add(_frame(float(k)))
    assert len(tail.since(0.0)) == 20_000


def test_two_seconds_before_the_loss_are_kept_once_it_is_noticed_and_stay_as_they_are() -> None:
    hearing = Hearing()
    charger, link = hearing.charger, hearing.charger._link
    for k in range(120):
        hearing.status()
        link.tail.add(_frame(hearing.clock.time_s, STATUS.encode(k % 15)))
    assert charger.traffic_before_loss() == ()
    last_s = hearing.clock.time_s
    hearing.clock.time_s += 0.26
    link.tail.add(replace(_frame(hearing.clock.time_s), direction="tx"))
    with pytest.raises(LinkLostError):
        charger.status()
    kept = charger.traffic_before_loss()
    assert kept[0].time_s == pytest.approx(last_s - 2.0, abs=0.051)
    assert kept[-1].direction == "tx", "ours after the last of theirs too"
    assert 40 <= len(kept) <= 42
    hearing.clock.time_s += 5.0
    with pytest.raises(LinkLostError):
        charger.status()
    assert charger.traffic_before_loss() == (), "told once"


def test_the_evidence_is_in_the_recording_and_beside_it_and_can_be_read(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "mission.mcap", MonotonicClock())
    frames = [_frame(10.0 + 0.05 * k, STATUS.encode(k % 15, State=6)) for k in range(40)]
    keep_charger_loss(recorder, frames)
    recorder.close()
    attached = read_recording(tmp_path / "mission.mcap").attachments[CHARGER_LOSS_NAME]
    beside = tmp_path / CHARGER_LOSS_NAME
    assert attached.data == beside.read_bytes()
    traffic = CanTraffic(CONTRACT, listen_to_file(beside))
    for _ in traffic.listen():
        pass
    status = next(row for row in traffic.health() if row.name == "CH_Status")
    assert (status.frames, status.accepted) == (40, 39)
    assert dict(status.values)["State"] == "Charging"


def test_without_a_loss_there_is_no_evidence(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "mission.mcap", MonotonicClock())
    keep_charger_loss(recorder, ())
    recorder.close()
    assert not (tmp_path / CHARGER_LOSS_NAME).exists()


def test_candump_lines_are_candumps_own() -> None:
    error = CanFrame(2.0, "rx", 0x040, bytes(8), is_extended=False, is_error=True)
    fd = CanFrame(3.0, "tx", 0x123, bytes(12), is_extended=False, is_fd=True)
    lines = candump_text([_frame(1.5, bytes(range(8))), error, fd]).splitlines()
    assert lines[0] == "(1.500000) can0 0CFF2056#0001020304050607 R"
    assert lines[1] == "(2.000000) can0 20000040#0000000000000000 R"
    assert lines[2] == "(3.000000) can0 123##1000000000000000000000000 T"


def test_error_frames_of_a_candump_log_keep_being_error_frames(tmp_path: Path) -> None:
    path = tmp_path / "bus-off.log"
    path.write_text(candump_text([CanFrame(2.0, "rx", 0x040, bytes(8), is_extended=False, is_error=True)]))
    traffic = CanTraffic(CONTRACT, listen_to_file(path))
    for _ in traffic.listen():
        pass
    assert (traffic.errors, traffic.foreign) == (1, 0)


# --- what cannot wait -------------------------------------------------------------------------------------------------


def _alarms(hearing: Hearing) -> list[float]:
    seen: list[float] = []
    hearing.charger.alert(lambda: seen.append(hearing.clock.time_s))
    return seen


@pytest.mark.parametrize("bad", [{"EStop": 1}, {"MotionInhibit": 1}, {"State": 10}, {"State": 11}])
def test_the_frame_that_says_stop_alarms_once(bad: dict[str, int]) -> None:
    hearing = Hearing()
    seen = _alarms(hearing)
    for counter in range(12):
        hearing.clock.time_s += 0.05
        values = {"State": 1} | (bad if counter >= 6 else {})
        frame = STATUS.encode(counter, **values)
        hearing.charger._receive(STATUS.arbitration_id, frame, hearing.clock.time_s)
    assert seen == [pytest.approx(100.35)]


def test_a_damaged_frame_or_another_message_alarms_nobody() -> None:
    hearing = Hearing()
    seen = _alarms(hearing)
    hearing.status()
    frame = bytearray(STATUS.encode(1, EStop=1))
    frame[0] ^= 1
    hearing.charger._receive(STATUS.arbitration_id, bytes(frame), hearing.clock.time_s)
    hearing.charger._receive(ELECTRICAL.arbitration_id, ELECTRICAL.encode(0, Current=1.0), hearing.clock.time_s)
    assert seen == []


def test_a_supervisor_that_is_woken_ticks_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With ticks an hour apart only the wake can bring the next one."""
    monkeypatch.setattr(controller.supervisor, "TICK_S", 3600.0)
    rig = Rig(tmp_path)
    supervisor = Supervisor(Sources(rig.arm, rig.charger, rig.scanner), MonotonicClock(), MonotonicClock(), 60.0)
    supervisor.start()
    try:
        _until(lambda: supervisor.ticks == 1)
        supervisor.wake()
        _until(lambda: supervisor.ticks == 2)
    finally:
        supervisor.close()


def _until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end_s, "never happened"
        time.sleep(0.002)


# --- stale values -----------------------------------------------------------------------------------------------------


def test_a_current_that_is_no_longer_told_is_no_current() -> None:
    hearing = Hearing()
    for counter in range(3):
        hearing.status()
        hearing.charger._receive(ELECTRICAL.arbitration_id, ELECTRICAL.encode(counter), hearing.clock.time_s)
    assert hearing.charger.status().current_a == 0.0
    for _ in range(11):  # 0.55 s: the status goes on, the measured values do not
        hearing.status()
    status = hearing.charger.status()
    assert np.isnan(status.current_a)
    assert np.isnan(status.voltage_v)
    assert not abs(status.current_a) < 1.0, "no limit is kept by what is not known"
    assert status.state is ChargerState.IDLE


# --- no protection ----------------------------------------------------------------------------------------------------


def test_unprotected_frames_must_be_accepted_before_anything_is_built() -> None:
    config = parse_config({"charger": {"protection": "none"}})
    with pytest.raises(ConfigError, match="unprotected") as caught:
        check_can_protection(config.charger)
    assert "accept_unprotected_can: true" in caught.value.remedy
    with pytest.raises(ConfigError, match="unprotected"):
        build_devices(config, NullSink(), MonotonicClock())


def test_accepted_unprotected_frames_are_said_in_the_status() -> None:
    config = parse_config({"charger": {"protection": "none", "accept_unprotected_can": True}})
    assert "not protected" in check_can_protection(config.charger)
    charger = build_devices(config, NullSink(), MonotonicClock()).charger
    assert "frames are not protected" in charger.health().detail


@pytest.mark.parametrize("protection", ["counter", "j1850", "e2e-p11"])
def test_protected_frames_need_no_word(protection: str) -> None:
    config = parse_config({"charger": {"protection": protection}})
    assert check_can_protection(config.charger) == ""
    charger = CanCharger(CanSettings("none", protection=Scheme(protection)), MonotonicClock())
    assert "protected" not in charger.health().detail
