"""A supplier's own DBC: other identifiers, scaling, byte order and layout, the same signal names, no new code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from controller.config import parse_config
from controller.wiring import build_devices
from drivers.base import ChargerRequest, ChargerState, MonotonicClock, NullSink
from drivers.charger.contract import Contract, bundled_dbc
from perception.errors import InputError
from tests.contract.charger_bench import PATIENT, QUICK, Bench, MockProcess

R = ChargerRequest
IDENTIFIERS = {"RC_Heartbeat": 0x110, "RC_Command": 0x111, "RC_DockPos": 0x112, "RC_DockRot": 0x113,
               "RC_DockQuality": 0x114, "CH_Status": 0x220, "CH_Electrical": 0x221}  # fmt: skip
CHANGES = (
    ("SG_ Voltage : 16|16@1+ (0.1,0) [0|6553.5]", "SG_ Voltage : 39|16@0+ (0.5,0) [0|32767.5]"),  # Motorola, moved
    ("SG_ Current : 32|16@1- (0.1,0) [-3276.8|3276.7]", "SG_ Current : 16|16@1- (0.05,0) [-1638.4|1638.35]"),
    ("SG_ CRC8 : 0|8@1+", "SG_ CRC8 : 56|8@1+", "CH_Status"),
    ("SG_ FaultCode : 48|16@1+", "SG_ FaultCode : 0|16@1+", "CH_Status"),
    ("SG_ Counter : 8|4@1+", "SG_ Counter : 48|4@1+", "CH_Status"),
    ("SG_ State : 12|4@1+", "SG_ State : 52|4@1+", "CH_Status"),
)


def _supplier(folder: Path) -> Path:
    """The bundled contract with everything elsewhere."""
    text = bundled_dbc().read_text()
    for name, identifier in IDENTIFIERS.items():
        number = re.search(rf"BO_ (\d+) {name}:", text)
        assert number is not None
        text = text.replace(number[1], str(identifier))
    for old, new, *where in CHANGES:
        start = text.index(f"BO_ {IDENTIFIERS[where[0]]} {where[0]}:") if where else 0
        assert old in text[start:]
        text = text[:start] + text[start:].replace(old, new, 1)
    path = folder / "supplier.dbc"
    path.write_text(text)
    return path


def test_a_whole_charging_session_under_the_suppliers_file(tmp_path: Path) -> None:
    dbc = _supplier(tmp_path)
    contract = Contract(dbc)
    assert contract["CH_Status"].protection.crc_offset == 7
    assert not contract["CH_Status"].is_extended
    mock = MockProcess(tmp_path, PATIENT, QUICK, f"--dbc={dbc}")
    bench = Bench(mock, dbc=dbc)
    try:
        bench.charge()
        status = bench.charger.status()
        assert status.state is ChargerState.CHARGING
        assert status.voltage_v == pytest.approx(400.0, abs=20.0)
        bench.must(R.STOP_POWER, R.UNLOCK_PLUG)
        assert {frame.arbitration_id for frame in bench.log.frames} == set(IDENTIFIERS.values()) - {0x112, 0x113, 0x114}
        assert not any(frame.is_extended for frame in bench.log.frames)
    finally:
        bench.close()
        mock.stop()


def test_other_source_addresses(tmp_path: Path) -> None:
    mock = MockProcess(tmp_path, PATIENT, "--robot-address=33", "--charger-address=67")
    bench = Bench(mock, robot_address=33, charger_address=67)
    try:
        bench.welcome()
        bench.must(R.RESERVE)
        assert {frame.arbitration_id & 0xFF for frame in bench.log.frames} == {33, 67}
    finally:
        bench.close()
        mock.stop()


def test_what_a_file_lacks_is_named_before_anything_is_opened(tmp_path: Path) -> None:
    path = tmp_path / "poor.dbc"
    path.write_text(bundled_dbc().read_text().replace(" AckSeq ", " Echo ").replace(" RMSE ", " Spread "))
    config = parse_config({"charger": {"dbc": str(path)}})
    with pytest.raises(InputError) as caught:
        build_devices(config, NullSink(), MonotonicClock())
    assert "RC_DockQuality.RMSE, CH_Status.AckSeq" in caught.value.cause


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (('[-1638.35|1638.35] "mm"', '[-1638.35|1638.35] "m"'), "RC_DockPos.X is in m, not in mm"),
        (("SG_ Z : 48|16@1- (0.05,0) [-1638.35", "SG_ Z : 48|16@1- (0.05,0) [0"), "RC_DockPos.Z reaches from 0 to"),
        (("SG_ X : 16|16@1- (0.05,0) [-1638.35|1638.35]", "SG_ X : 16|16@1- (1,0) [-2000|2000]"), "steps of 1 mm"),
        (("SG_ Current : 32|16@1- (0.1,0)", "SG_ Current : 32|16@1- (2,0)"), "CH_Electrical.Current has steps of 2 A"),
        (('[-3276.8|3276.7] "A"', '[-3276.8|3276.7] "mA"'), "CH_Electrical.Current is in mA, not in A"),
        (("SG_ Pilot : 22|3@1+ (1,0) [0|7]", "SG_ Pilot : 22|2@1+ (1,0) [0|3]"), "CH_Status.Pilot goes up to 3, 5 is"),
        (("SG_ Cmd : 12|4@1+ (1,0)", "SG_ Cmd : 12|4@1+ (2,0)"), "RC_Command.Cmd is scaled"),
        (("SG_ AckSeq : 32|8@1+", "SG_ AckSeq : 32|7@1+"), "CH_Status.AckSeq goes up to 127, 255 is needed"),
        (
            ("SG_ Counter : 8|4@1+ (1,0) [0|14]", "SG_ Counter : 8|3@1+ (1,0) [0|7]"),
            "RC_Heartbeat.Counter goes up to 7",
        ),
    ],
)
def test_signals_that_mean_something_else_are_named(tmp_path: Path, change: tuple[str, str], complaint: str) -> None:
    text = bundled_dbc().read_text()
    assert change[0] in text
    path = tmp_path / "strange.dbc"
    path.write_text(text.replace(*change))
    with pytest.raises(InputError) as caught:
        Contract(path)
    assert complaint in caught.value.cause


def test_a_unit_may_be_left_out_or_spelled_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "terse.dbc"
    path.write_text(bundled_dbc().read_text().replace('"mm"', '""').replace('"degC"', '"C"').replace('"A"', '"a"'))
    assert Contract(path)["RC_DockPos"].length == 8
