"""The DBC that is handed to a charger's supplier: complete, strict, and what docs/can.md says."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import cantools
import pytest
from typer.testing import CliRunner

from controller.cli.charger import app
from controller.cli.charger_contract import describe
from drivers.base import ChargerRequest, ChargerState, Pilot, PlugLock, Proximity
from drivers.charger.contract import BEAT_SIGNALS, CHARGER_SIGNALS, THREE_FRAMES, bundled_dbc
from perception.errors import InputError
from tests.unit.charger_frames import FRAMES
from tests.unit.test_charger_fd import LITERALS

DATABASE: Any = cantools.database.load_file(bundled_dbc(), strict=True)

LAYOUT = {
    "RC_Heartbeat": "CRC8 0|8, Counter 8|4, Mode 12|4, State 16|8, Flags 24|16, CycleId 40|16",
    "RC_Command": "CRC8 0|8, Counter 8|4, Cmd 12|4, CmdSeq 16|8, Arg 24|16",
    "RC_DockPos": "CRC8 0|8, Counter 8|4, PosSeq 12|4, X 16|16, Y 32|16, Z 48|16",
    "RC_DockRot": "CRC8 0|8, Counter 8|4, RotSeq 12|4, RX 16|16, RY 32|16, RZ 48|16",
    "RC_DockQuality": "CRC8 0|8, Counter 8|4, QualSeq 12|4, Valid 16|2, Frame 18|2, Method 20|4, RMSE 24|12, "
    "Age 36|12, Fitness 48|8, Tolerance 56|8",
    "CH_Status": "CRC8 0|8, Counter 8|4, State 12|4, PlugLock 16|3, Prox 19|3, Pilot 22|3, ContactorClosed 25|1, "
    "DockEnable 26|1, MotionInhibit 27|1, EStop 28|1, AckSeq 32|8, AckResult 40|4, FaultCode 48|16",
    "CH_Electrical": "CRC8 0|8, Counter 8|4, Voltage 16|16, Current 32|16, TempDC 48|8, SoC 56|8",
}
TIMES_MS = {  # cycle, degraded, lost
    "RC_Heartbeat": (50, 150, 250),
    "RC_Command": (100, 0, 0),
    "RC_DockPos": (100, 0, 300),
    "RC_DockRot": (100, 0, 300),
    "RC_DockQuality": (100, 0, 300),
    "CH_Status": (50, 150, 250),
    "CH_Electrical": (100, 300, 500),
}


@pytest.mark.parametrize("name", LAYOUT)
def test_signals_lie_where_the_contract_puts_them(name: str) -> None:
    message = DATABASE.get_message_by_name(name)
    assert ", ".join(f"{s.name} {s.start}|{s.length}" for s in message.signals) == LAYOUT[name]
    assert message.length == 8
    assert message.is_extended_frame
    assert all(s.byte_order == "little_endian" for s in message.signals)


def test_the_file_has_these_messages_and_no_others() -> None:
    assert (
        {m.name for m in DATABASE.messages}
        == set(LAYOUT)
        == set(FRAMES)
        == set(BEAT_SIGNALS | THREE_FRAMES | CHARGER_SIGNALS)
    )


@pytest.mark.parametrize("name", FRAMES)
def test_the_literal_frame_carries_these_values(name: str) -> None:
    identifier, frame, values = FRAMES[name]
    message = DATABASE.get_message_by_name(name)
    assert message.frame_id == identifier
    decoded = message.decode(bytes.fromhex(frame), decode_choices=False)
    assert decoded == pytest.approx(values | {"CRC8": int(frame[:2], 16)}, abs=1e-9)


@pytest.mark.parametrize("name", TIMES_MS)
def test_cycles_and_time_outs_stand_in_the_file(name: str) -> None:
    message = DATABASE.get_message_by_name(name)
    attributes = message.dbc.attributes
    degraded = attributes["TimeoutDegradedMs"].value if "TimeoutDegradedMs" in attributes else 0
    lost = attributes["TimeoutLostMs"].value if "TimeoutLostMs" in attributes else 0
    assert (message.cycle_time, degraded, lost) == TIMES_MS[name]
    assert message.send_type in ("Cyclic", "CyclicAndOnChange", "CyclicIfActive")


def test_the_data_id_of_every_message_is_its_pgn() -> None:
    for message in DATABASE.messages:
        assert message.dbc.attributes["E2EDataID"].value == message.frame_id >> 8 & 0xFFFF


def test_everything_has_a_comment() -> None:
    for message in DATABASE.messages:
        assert message.comment, message.name
        first = [s for s in message.signals if message.name == "RC_Heartbeat" or s.name not in ("CRC8", "Counter")]
        for signal in first:
            assert signal.comment, f"{message.name}.{signal.name}"


@pytest.mark.parametrize(
    ("message", "signal", "kind"),
    [
        ("CH_Status", "State", ChargerState),
        ("CH_Status", "Prox", Proximity),
        ("CH_Status", "Pilot", Pilot),
        ("CH_Status", "PlugLock", PlugLock),
        ("RC_Command", "Cmd", ChargerRequest),
    ],
)
def test_value_tables_say_what_the_code_says(message: str, signal: str, kind: Any) -> None:
    choices = DATABASE.get_message_by_name(message).get_signal_by_name(signal).choices
    assert {n: str(c).lower() for n, c in choices.items()} == {
        member.value: member.name.replace("_", "").lower() for member in kind
    }


def test_the_load_on_the_bus_stays_below_six_percent() -> None:
    longest_bits = 160  # an 8-byte extended frame with every stuff bit
    per_second = sum(1000 / m.cycle_time for m in DATABASE.messages)
    assert per_second == 90
    assert per_second * longest_bits / DATABASE.dbc.attributes["Baudrate"].value < 0.06


def test_no_two_messages_share_an_identifier() -> None:
    assert all(a.frame_id != b.frame_id for a, b in itertools.combinations(DATABASE.messages, 2))


def test_the_file_is_package_data() -> None:
    assert bundled_dbc() == Path(bundled_dbc())
    assert bundled_dbc().is_file()


# --- docs/can.md ----------------------------------------------------------------------------------------------------

PAGE = Path(__file__).parents[2] / "docs" / "can.md"


def test_the_page_is_what_describe_prints() -> None:
    result = CliRunner().invoke(app, ["describe"])
    assert result.exit_code == 0
    assert PAGE.read_text() == result.stdout, "run `portdock charger describe > docs/can.md`"


def test_the_page_names_every_signal_and_carries_the_test_vectors() -> None:
    page = PAGE.read_text()
    for message in DATABASE.messages:
        section = page.split(f"### {message.name}\n")[1].split("\n##")[0]
        for signal in message.signals:
            assert f"| {signal.name} | {signal.start}\\|{signal.length} |" in section
        assert f"| {message.name} | `{FRAMES[message.name][1]}` |" in page


def test_the_page_carries_the_vectors_of_can_fd() -> None:
    page = PAGE.read_text()
    for name, (literal, _) in LITERALS.items():
        assert f"| {name} | `{literal.hex(' ').upper()}`" in page


def test_another_dbc_is_described_and_a_missing_one_named(tmp_path: Path) -> None:
    path = tmp_path / "supplier.dbc"
    path.write_text(bundled_dbc().read_text().replace("SG_ SoC : 56|8@1+ (0.5,0)", "SG_ SoC : 56|8@1+ (0.4,0)"))
    assert "| SoC | 56\\|8 | unsigned | 0.4 | % |" in describe(path)
    with pytest.raises(InputError, match="there is no DBC"):
        describe(tmp_path / "none.dbc")
