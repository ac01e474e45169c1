"""Listening to traffic: each message's health, from a recording."""

from __future__ import annotations

from pathlib import Path

import can
import pytest
from typer.testing import CliRunner

from controller.cli.charger import app
from drivers.base import CanFrame
from drivers.charger.contract import Contract
from drivers.charger.e2e import next_counter
from drivers.charger.traffic import CanTraffic, listen_to_file
from perception.errors import InputError

CONTRACT = Contract()
STATUS = CONTRACT["CH_Status"]
VALUES: dict[str, float] = {
    "State": 6,
    "PlugLock": 2,
    "Prox": 2,
    "Pilot": 2,
    "ContactorClosed": 1,
    "DockEnable": 0,
    "MotionInhibit": 1,
    "EStop": 0,
    "AckSeq": 42,
    "AckResult": 2,
    "FaultCode": 0,
}


def _recording(path: Path) -> Path:
    """Twenty status frames 50 ms apart; one damaged, one missing, one repeated; a foreign and an error frame."""
    counter, frames = 0, []
    for k in range(20):
        data = bytearray(STATUS.encode(counter, **VALUES))
        if k == 5:
            data[4] ^= 1
        if k != 10:
            frames.append(bytes(data))
        if k == 15:
            frames.append(bytes(data))
        counter = next_counter(counter, 15)
    with can.Logger(path) as log:
        for k, data in enumerate(frames):
            log(can.Message(timestamp=100 + 0.05 * k, arbitration_id=STATUS.arbitration_id, data=data))
        log(can.Message(timestamp=101.5, arbitration_id=0x123, is_extended_id=False, data=b"\x01"))
        log(
            can.Message(timestamp=101.6, arbitration_id=0x040, is_error_frame=True, is_extended_id=False, data=bytes(8))
        )
    return path


@pytest.mark.parametrize("name", ["traffic.log", "traffic.blf"])
def test_the_health_of_a_message_is_read_from_a_recording(tmp_path: Path, name: str) -> None:
    traffic = CanTraffic(CONTRACT, listen_to_file(_recording(tmp_path / name)))
    for _ in traffic.listen():
        pass
    status = next(row for row in traffic.health() if row.name == "CH_Status")
    assert (status.frames, status.accepted) == (20, 17)
    assert (status.bad_checksum, status.repeated, status.wrong_sequence) == (1, 1, 0)
    assert status.missed == 2, "the damaged one and the missing one"
    assert status.period_s == pytest.approx(0.05, abs=1e-3)
    assert dict(status.values)["State"] == "Charging"
    assert (traffic.foreign, traffic.errors) == (1, 1)
    states = {row.name: row.state for row in traffic.health()}
    assert states["CH_Status"] == "lost for 0.6 s", "its last frame is older than the recording's end"
    assert states["RC_Heartbeat"] == "never heard"


def _listened(until_s: float, *, damaged: int = -1, beats: int = 40) -> dict[str, str]:
    """The states at a time, of a bus that carried status frames every 50 ms, and one pose frame at the beginning."""
    status, pose = STATUS, CONTRACT["RC_DockPos"]
    frames = [CanFrame(0.0, "rx", pose.arbitration_id, pose.encode(k, PosSeq=1, X=1, Y=2, Z=3)) for k in range(2)]
    for k in range(beats):
        data = bytearray(status.encode(k % 15, **VALUES))
        data[4] ^= k == damaged
        frames.append(CanFrame(0.05 * k, "rx", status.arbitration_id, bytes(data)))
    traffic = CanTraffic(CONTRACT, frames, lambda: until_s)
    for _ in traffic.listen():
        pass
    return {row.name: row.state for row in traffic.health()}


def test_each_message_is_said_to_be_good_late_or_lost() -> None:
    last_s = 0.05 * 39
    assert _listened(last_s + 0.1)["CH_Status"] == "good"
    assert _listened(last_s + 0.2)["CH_Status"] == "late"
    assert _listened(last_s + 0.3)["CH_Status"] == "lost for 0.3 s"
    assert _listened(last_s, damaged=35)["CH_Status"] == "1 of 20 bad"
    assert _listened(last_s, damaged=10)["CH_Status"] == "good", "long ago"
    assert _listened(last_s, beats=1)["CH_Status"] == "no good frame", "one frame alone proves no life"
    assert _listened(last_s)["RC_DockPos"] == "not being sent", "a pose is only announced while there is one"


def test_monitor_prints_the_table(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["monitor", "--file", str(_recording(tmp_path / "t.log"))])
    assert result.exit_code == 0
    assert "CH_Status" in result.stdout
    assert "RC_Heartbeat" in result.stdout
    assert "never heard" in result.stdout


@pytest.mark.parametrize("arguments", [[], ["--channel", "x", "--file", "y"]])
def test_monitor_wants_one_source(arguments: list[str]) -> None:
    result = CliRunner().invoke(app, ["monitor", *arguments])
    assert isinstance(result.exception, InputError)


def test_what_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    for name, text in (("none.log", None), ("junk.log", "what is this\n"), ("file.xyz", "")):
        if text is not None:
            (tmp_path / name).write_text(text)
        with pytest.raises(InputError) as caught:
            list(listen_to_file(tmp_path / name))
        assert "\n" not in caught.value.cause
