"""Dashboard and primary port of the emulated controller, as text and bytes."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest

from mocks.ur.dashboard import DashboardClient, DashboardCommands
from mocks.ur.primary import PrimaryClient
from mocks.ur.state import RuntimeState
from tests.unit.mock_ur_parts import Wire, new_controller, run


def _dashboard(programs: Path | None = None):
    controller, wire = new_controller(), Wire()
    client = DashboardClient(wire, DashboardCommands(controller, "20240000001", programs))  # type: ignore[arg-type]
    assert wire.take() == b"Connected: Universal Robots Dashboard Server\n"

    def ask(line: str) -> str:
        client.received(line.encode() + b"\n")
        return wire.take().decode().removesuffix("\n")

    return controller, ask, wire


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("stop", "Stopped"),
        ("play", "Failed to execute: play"),
        ("pause", "Failed to execute: pause"),
        ("running", "Program running: false"),
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("programState", "STOPPED <unnamed>"),
        ("get loaded program", "No program loaded"),
        ("load nothing.urp", "File not found: nothing.urp"),
        ("popup take care", "showing popup"),
        ("close popup", "closing popup"),
        ("close safety popup", "closing safety popup"),
        ("addToLog hello", "Added log message"),
        ("PolyscopeVersion", "URSoftware 5.15.0.7 (Jan 01 2024)"),
        ("version", "5.15.0.7"),
        ("get serial number", "20240000001"),
        ("get robot model", "UR10"),
        ("is in remote control", "true"),
        ("set operational mode automatic", "Operational mode AUTOMATIC is set"),
        ("get operational mode", "NONE"),
        ("power on", "Powering on"),
        ("power off", "Powering off"),
        ("brake release", "Brake releasing"),
        ("restart safety", "Restarting safety"),
        ("quit", "Disconnected"),
        ("dance", "could not understand: 'dance'"),
        ("", "could not understand: ''"),
    ],
)
def test_replies_are_in_universal_robots_words(line: str, reply: str) -> None:
    _, ask, _ = _dashboard()
    assert ask(line) == reply


def test_quit_closes_the_connection() -> None:
    _, ask, wire = _dashboard()
    ask("quit")
    assert wire.closed


def test_lines_may_arrive_in_pieces_and_together() -> None:
    controller, wire = new_controller(), Wire()
    client = DashboardClient(wire, DashboardCommands(controller, "1"))  # type: ignore[arg-type]
    wire.take()
    client.received(b"rob")
    client.received(b"otmode\r\nrunning\nsaf")
    assert wire.take() == b"Robotmode: RUNNING\nProgram running: false\n"


def test_a_protective_stop_is_not_unlocked_within_five_seconds() -> None:
    controller, ask, _ = _dashboard()
    controller.protective_stop()
    assert ask("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s after occurrence")
    run(controller, 5.1)
    assert ask("unlock protective stop") == "Protective stop releasing"


def test_a_program_from_the_folder_is_loaded_played_and_ends(tmp_path: Path) -> None:
    (tmp_path / "wave.script").write_text("def wave():\n  movej([0.1,-1.5708,1.5708,-1.5708,-1.5708,0.0])\nend\n")
    controller, ask, _ = _dashboard(tmp_path)
    assert ask("load wave.urp") == "Loading program: wave.urp"
    assert ask("programState") == "STOPPED wave.urp"
    assert ask("play") == "Starting program"
    assert (ask("programState"), ask("running")) == ("PLAYING wave.urp", "Program running: true")
    run(controller, 3.0)
    assert controller.arm.q[0] == pytest.approx(0.1) and ask("running") == "Program running: false"
    assert ask("load ../../etc/passwd").startswith("File not found")


def test_in_local_mode_the_dashboard_moves_nothing(tmp_path: Path) -> None:
    (tmp_path / "wave.script").write_text("def wave():\n  sleep(1)\nend\n")
    controller, ask, _ = _dashboard(tmp_path)
    ask("load wave.urp")
    controller.remote = False
    assert ask("is in remote control") == "false"
    assert ask("play") == "Failed to execute: play" and controller.runtime_state == RuntimeState.STOPPED
    controller.remote = True
    assert ask("play") == "Starting program" and ask("pause") == "Pausing program"
    controller.remote = False
    assert ask("play") == "Failed to execute: play" and controller.runtime_state == RuntimeState.PAUSED


# --- primary port -----------------------------------------------------------------------------------------------------


def _packages(data: bytes) -> list[tuple[int, bytes]]:
    """(type, body) of each length-prefixed package."""
    found = []
    while data:
        size, kind = struct.unpack_from(">iB", data)
        found.append((kind, data[5:size]))
        data = data[size:]
    return found


def test_the_first_message_tells_the_version() -> None:
    wire = Wire()
    PrimaryClient(wire, new_controller())  # type: ignore[arg-type]
    [(kind, body)] = _packages(wire.take())
    assert kind == 20 and body[8:10] == b"\xfe\x03"
    assert body[10:30] == b"\x09URControl\x05\x0f\x00\x00\x00\x00\x00\x00\x00\x07"


def test_a_state_message_holds_the_documented_sub_packages() -> None:
    controller, wire = new_controller(), Wire()
    client = PrimaryClient(wire, controller)  # type: ignore[arg-type]
    wire.take()
    run(controller, 0.2)
    client.send_state()
    [(kind, body)] = _packages(wire.take())
    packages = _packages(body)
    assert kind == 16
    assert {number: len(part) + 5 for number, part in packages} == {0: 47, 1: 251, 2: 37, 3: 75, 4: 101, 5: 225}
    parts = dict(packages)
    assert struct.unpack_from(">Q7BB", parts[0])[1:] == (1, 1, 1, 0, 0, 0, 0, 7)
    assert struct.unpack_from(">d", parts[1], 41)[0] == pytest.approx(controller.arm.q[1])
    assert struct.unpack_from(">6d", parts[4]) == pytest.approx(controller.tcp_pose)
    assert struct.unpack_from(">6d", parts[5], 24 + 48)[1] == -0.6127


def test_state_messages_come_ten_times_a_second() -> None:
    controller, wire = new_controller(), Wire()
    client = PrimaryClient(wire, controller)  # type: ignore[arg-type]
    for _ in range(250):
        controller.tick(0.008)
        client.send_state()
    assert len([kind for kind, _ in _packages(wire.take()) if kind == 16]) in (19, 20)


def test_a_program_that_starts_and_stops_is_told_by_key_messages() -> None:
    controller, wire = new_controller(), Wire()
    client = PrimaryClient(wire, controller)  # type: ignore[arg-type]
    controller.on_program = client.send_key
    wire.take()
    client.received(b"def nod():\n  sleep(0.1)\nend\n")
    run(controller, 0.3)
    titles = [re.findall(rb"PROGRAM_XXX_\w+ED", body)[0] for kind, body in _packages(wire.take()) if kind == 20]
    assert titles == [b"PROGRAM_XXX_STARTED", b"PROGRAM_XXX_STOPPED"]
