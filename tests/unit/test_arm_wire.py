"""The driver's own two conversations, dashboard and RTDE probe, against literal bytes."""

from __future__ import annotations

import socket
import threading
from contextlib import contextmanager

import pytest

from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import ArmAbsentError
from drivers.arm.rtde_probe import controller_version
from drivers.base import LinkLostError, ProtocolError
from tests.arm_rig import own_address

BANNER = b"Connected: Universal Robots Dashboard Server\n"


@contextmanager
def scripted_server(port: int, script: list[tuple[bytes, bytes]], greeting: bytes = b""):
    """Sends ``greeting``, then for each pair waits for exactly the first and sends the second; then hangs up."""
    host = own_address()
    seen: list[bytes] = []
    server = socket.create_server((host, port))

    def run() -> None:
        link, _ = server.accept()
        with link:
            link.settimeout(5.0)
            link.sendall(greeting)
            for expected, answer in script:
                data = b""
                while len(data) < len(expected):
                    chunk = link.recv(len(expected) - len(data))
                    if not chunk:
                        break
                    data += chunk
                seen.append(data)
                link.sendall(answer)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield host, seen
    finally:
        thread.join(5.0)
        server.close()


def test_the_dashboard_speaks_lines() -> None:
    script = [(b"robotmode\n", b"Robotmode: RUNNING\n"), (b"safetystatus\n", b"Safetystatus: PROTECTIVE_STOP\n")]
    with scripted_server(29999, script, BANNER) as (host, seen), Dashboard(host) as dashboard:
        assert dashboard.robot_mode() == "RUNNING"
        assert dashboard.safety_status() == "PROTECTIVE_STOP"
    assert seen == [b"robotmode\n", b"safetystatus\n"]


def test_a_refused_stop_is_reported_with_the_servers_words() -> None:
    script = [(b"stop\n", b"Failed to execute: stop\n")]
    with (
        scripted_server(29999, script, BANNER) as (host, _),
        Dashboard(host) as dashboard,
        pytest.raises(ProtocolError, match="Failed to execute"),
    ):
        dashboard.stop()


def test_a_server_that_hangs_up_is_a_lost_link() -> None:
    with (
        scripted_server(29999, [(b"running\n", b"Program run")], BANNER) as (host, _),
        Dashboard(host) as dashboard,
        pytest.raises(LinkLostError),
    ):
        dashboard.program_running()


def test_another_server_at_the_port_is_recognised() -> None:
    with scripted_server(29999, [], b"220 ftp ready\n") as (host, _), pytest.raises(ProtocolError):
        Dashboard(host)


VERSION = (bytes.fromhex("0005560002"), bytes.fromhex("00045601"))
CONTROLLER = (bytes.fromhex("000376"), bytes.fromhex("001376 00000005 0000000f 00000002 00000063"))
OUTPUTS = (bytes.fromhex("00144f 405f400000000000") + b"timestamp", bytes.fromhex("000a4f01") + b"DOUBLE")
START = (bytes.fromhex("000353"), bytes.fromhex("00045301") + bytes.fromhex("000c5501 3ff0000000000000"))


def test_the_probe_asks_for_version_and_data() -> None:
    script = [VERSION, CONTROLLER, OUTPUTS, START]
    with scripted_server(30004, script) as (host, seen):
        assert controller_version(host, 2.0) == (5, 15, 2, 99)
    assert seen == [expected for expected, _ in script]


def test_text_messages_between_answers_are_passed_over() -> None:
    message = bytes.fromhex("000a4d 02 6869 02 6d65 01")
    script = [VERSION, (CONTROLLER[0], message + CONTROLLER[1]), OUTPUTS, START]
    with scripted_server(30004, script) as (host, _):
        assert controller_version(host, 2.0)[:2] == (5, 15)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_controller_that_stops_answering_is_absent(count) -> None:
    script = [VERSION, CONTROLLER, OUTPUTS][:count]
    with scripted_server(30004, script) as (host, _), pytest.raises(ArmAbsentError):
        controller_version(host, 0.5)


def test_a_controller_that_refuses_the_protocol() -> None:
    with (
        scripted_server(30004, [(VERSION[0], bytes.fromhex("00045600"))]) as (host, _),
        pytest.raises(ArmAbsentError, match="protocol"),
    ):
        controller_version(host, 2.0)
