"""The daemon as a process: jobs over its socket, signals, the lock, systemd, death and the next start."""

from __future__ import annotations

import json
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from controller.daemon.client import DaemonClient
from controller.daemon.desk import JobDesk
from controller.daemon.protocol import Request, ResultEvent, StateEvent
from controller.daemon.server import BACKLOG_BYTES
from controller.recording.reader import read_recording
from controller.states import State
from drivers.base import PlugLock
from tests.unit.daemon_rig import LIMIT_S, SILENT, Nursery, Service

Start = Callable[..., Service]


@pytest.fixture(scope="module")
def nursery() -> Iterator[Nursery]:
    nursery = Nursery()
    yield nursery
    nursery.close()


@pytest.fixture
def start(nursery: Nursery, tmp_path: Path) -> Iterator[Start]:
    """Starts a daemon in the test's folder; all are ended with the test."""
    running: list[Service] = []

    def begin(**environment: str) -> Service:
        running.append(Service(nursery, tmp_path, environment))
        return running[-1]

    yield begin
    for service in running:
        service.close()


@pytest.fixture
def daemon(start: Start) -> Service:
    return start()


def recordings(folder: Path) -> list[Path]:
    return sorted((folder / "runs").glob("*/mission.mcap"))


def motions(daemon: Service) -> list[str]:
    return [move for move in daemon.world()["moves"] if move != "stop"]


class Interrupts:
    """What the desk passes on at once."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def request_stop(self) -> None:
        self.asked.append("stop")

    def request_abort(self) -> None:
        self.asked.append("abort")

    def clear_stop(self) -> None: ...


@pytest.mark.parametrize(("state", "answer"), [(State.FAULT, "nothing-to-do"), (State.READY, "accepted")])
def test_an_abort_is_passed_on_and_answered_at_once_where_nothing_moves_and_no_result_would_follow(
    state: State, answer: str
) -> None:
    desk, interrupts = JobDesk(lambda event: None), Interrupts()
    desk.open(interrupts, lambda: state)
    assert desk.submit(Request.ABORT).answer == answer
    assert interrupts.asked == ([] if state is State.FAULT else ["abort"])


# --- jobs -------------------------------------------------------------------------------------------------------------


def test_dock_and_undock_end_with_their_results_and_one_recording_each(daemon: Service) -> None:
    docked = daemon.job(Request.DOCK)
    assert (docked.outcome, docked.fault, daemon.status()["state"]) == ("charging", None, "CHARGING")
    assert daemon.job(Request.DOCK).outcome == "already-docked"
    undocked = daemon.job(Request.UNDOCK)
    assert undocked.outcome == "undocked" and daemon.job(Request.UNDOCK).outcome == "already-undocked"
    files = recordings(daemon.folder)
    assert [Path(r.summary["recording"]) for r in (docked, undocked)] == files
    passed = [[t.to_state for t in read_recording(file).transitions()] for file in files]
    assert passed[0][0] == "STAGING" and passed[0][-1] == "CHARGING" and passed[1][-1] == "READY"
    assert all(read_recording(file).complete for file in files)


def test_while_a_job_is_under_way_another_is_refused_and_a_stop_ends_it(daemon: Service) -> None:
    with daemon.client() as client:
        client.ask(Request.SUBSCRIBE)
        first = client.ask(Request.DOCK)
        second = client.ask(Request.UNDOCK)
        assert second.answer == "refused" and str(first.job) in second.reason
        assert client.ask(Request.STOP).answer == "accepted"
        result = _until_result(client)
    assert (result.job, result.outcome) == (first.job, "stopped")
    assert daemon.status()["state"] == "READY"


def _until_result(client: DaemonClient) -> ResultEvent:
    for event in client.events(LIMIT_S):
        if isinstance(event, ResultEvent):
            return event
    raise AssertionError


def test_a_stop_with_nothing_under_way_says_so(daemon: Service) -> None:
    with daemon.client() as client:
        assert client.ask(Request.STOP).answer == "nothing-to-do"


def test_an_abort_latches_and_only_a_reset_leads_out(daemon: Service) -> None:
    daemon.begin_until(Request.DOCK, "SCANNING")
    aborted = daemon.job(Request.ABORT)
    assert aborted.fault == "aborted" and daemon.status()["fault"] == "aborted"
    refused = daemon.job(Request.DOCK)
    assert (refused.outcome, refused.fault) == ("fault", "aborted")
    assert daemon.job(Request.RESET).outcome == "ready" and daemon.status()["healthy"]


def test_a_charger_that_falls_silent_in_ready_latches_and_comes_back_only_by_a_reset(daemon: Service) -> None:
    assert daemon.status()["state"] == "READY"
    (daemon.folder / SILENT).touch()
    _until(lambda: daemon.status()["state"] == "FAULT")
    assert daemon.status()["fault"] == "charger-link-lost"
    assert daemon.job(Request.RESET).fault == "charger-link-lost", "not while it is silent"
    (daemon.folder / SILENT).unlink()
    _until(lambda: daemon.status()["links"]["charger"]["up"])
    refused = daemon.job(Request.DOCK)
    assert (refused.outcome, refused.fault) == ("fault", "charger-link-lost"), "it is heard again: nothing goes on"
    assert daemon.job(Request.RESET).outcome == "ready"
    assert not motions(daemon)
    assert daemon.job(Request.DOCK).outcome == "charging"


def _until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_every_subscriber_sees_the_same_events(daemon: Service) -> None:
    with daemon.client() as one, daemon.client() as other:
        for client in (one, other):
            client.ask(Request.SUBSCRIBE)
        one.ask(Request.DOCK)
        seen = []
        for client in (one, other):
            states = []
            for event in client.events(LIMIT_S):
                if isinstance(event, StateEvent):
                    states.append(event.state)
                if isinstance(event, ResultEvent):
                    break
            seen.append(states)
    assert seen[0] == seen[1] and seen[0][0] == "STAGING" and seen[0][-1] == "CHARGING"


def test_garbage_on_the_socket_is_answered_and_harms_nobody(daemon: Service) -> None:
    with daemon.client() as client:
        for line in (
            b"hello\n",
            b'{"request": "fly"}\n',
            b"[]\n",
            b'{"request": 3}\n',
            b"\xff\xfe\n",
            b"[" * 5000 + b"\n",
        ):
            client._line.sendall(line)
            answer = json.loads(client._stream.readline())
            assert answer["answer"] == "refused" and answer["reason"]
        client._line.sendall(b"x" * 70_000 + b"\n")
        assert json.loads(client._stream.readline())["answer"] == "refused"
    assert daemon.status()["state"] == "READY"


def test_a_subscriber_that_never_reads_does_not_hold_the_daemon_up(daemon: Service) -> None:
    with daemon.client() as deaf:
        deaf.ask(Request.SUBSCRIBE)
        for _ in range(3000):
            try:
                deaf._line.settimeout(0.2)
                deaf._line.sendall(b'{"request": "status"}\n')
            except OSError:
                break
        assert daemon.job(Request.DOCK).outcome == "charging"
    assert BACKLOG_BYTES < 10_000_000


# --- signals ----------------------------------------------------------------------------------------------------------


def test_sigterm_in_ready_ends_with_status_0_and_takes_the_socket_away(daemon: Service) -> None:
    daemon.client()
    daemon.signal(signal.SIGTERM)
    assert daemon.ended() == 0 and not daemon.socket.exists()


def test_sigterm_while_charging_switches_off_keeps_the_lock_and_moves_nothing(daemon: Service) -> None:
    daemon.job(Request.DOCK)
    before = motions(daemon)
    daemon.signal(signal.SIGTERM)
    assert daemon.ended() == 0
    world = daemon.world()
    assert world["lock"] == PlugLock.LOCKED and not world["power"] and motions(daemon) == before
    assert (daemon.folder / "state" / "stand-in" / "insertion.json").exists()


@pytest.mark.parametrize("state", ["SCANNING", "LOCATING", "INSERTING"])
def test_sigterm_during_a_mission_finishes_it_safely_first(daemon: Service, state: str) -> None:
    daemon.begin_until(Request.DOCK, state)
    daemon.signal(signal.SIGTERM)
    assert daemon.ended() == 0
    passed = [t.to_state for t in read_recording(recordings(daemon.folder)[-1]).transitions()]
    assert passed[-1] == "READY" and ("RETREATING" in passed) == (state == "INSERTING")
    assert not (daemon.folder / "state" / "stand-in" / "insertion.json").exists()


def test_a_second_sigterm_freezes_motion_and_ends(daemon: Service) -> None:
    daemon.begin_until(Request.DOCK, "INSERTING")
    daemon.signal(signal.SIGTERM)
    daemon.says("finishing safely")  # two at once would be one to the kernel
    daemon.signal(signal.SIGTERM)
    assert daemon.ended() == 0
    assert "motion is frozen" in daemon.text()
    assert daemon.world()["moves"][-1] == "stop"


def test_sighup_says_what_would_change_and_changes_nothing(daemon: Service) -> None:
    with daemon.client() as client:
        client.ask(Request.SUBSCRIBE)
        daemon.signal(signal.SIGHUP)
        for event in client.events(LIMIT_S):
            assert "no site file" in event.text  # type: ignore[union-attr]
            break
    assert daemon.status()["state"] == "READY"


# --- one instance -----------------------------------------------------------------------------------------------------


def test_a_second_daemon_for_the_same_robot_is_refused_with_the_first_ones_number(
    daemon: Service, start: Start
) -> None:
    daemon.client()
    second = start()
    assert second.ended() != 0
    assert f"belongs to process {daemon.pid}" in second.text()
    assert daemon.status()["state"] == "READY"


# --- systemd ----------------------------------------------------------------------------------------------------------


def test_systemd_hears_ready_the_watchdog_from_the_tick_and_stopping(start: Start, tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    heard: list[str] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:

        def hear_until(wanted: str) -> None:
            while not heard or not heard[-1].startswith(wanted):
                heard.append(listener.recv(4096).decode())

        listener.bind(address)
        listener.settimeout(LIMIT_S)
        running = start(NOTIFY_SOCKET=address, WATCHDOG_USEC="400000")
        hear_until("READY=1\nSTATUS=READY")
        hear_until("WATCHDOG=1")
        running.signal(signal.SIGSTOP)
        listener.settimeout(1.0)
        with pytest.raises(TimeoutError):  # what was under way is still read; then a frozen daemon is silent
            for _ in range(100):
                listener.recv(4096)
        running.signal(signal.SIGCONT)
        listener.settimeout(LIMIT_S)
        heard.append("")
        hear_until("WATCHDOG=1")
        running.signal(signal.SIGTERM)
        hear_until("STOPPING=1")
        assert running.ended() == 0
    assert "STATUS=opening the devices" in heard


# --- death and the next start -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", ["STAGING", "SCANNING", "LOCATING", "APPROACHING"])
def test_killed_before_contact_the_next_start_is_ready_and_the_recording_recovered(
    start: Start, tmp_path: Path, state: str
) -> None:
    first = start()
    first.begin_until(Request.DOCK, state)
    end_s = time.monotonic() + LIMIT_S
    while not read_recording(recordings(tmp_path)[0]).transitions() and time.monotonic() < end_s:
        time.sleep(0.01)
    first.signal(signal.SIGKILL)
    first.ended()
    second = start()
    assert second.status()["state"] == "READY"
    assert motions(second) == []
    saved = read_recording(recordings(tmp_path)[0].with_name("mission-recovered.mcap"))
    assert "STAGING" in [t.to_state for t in saved.transitions()]
    assert saved.damage and all(text.startswith("recovered") for text in saved.damage)
    assert second.job(Request.DOCK).outcome == "charging"


@pytest.mark.parametrize("state", ["INSERTING", "VERIFYING", "RELEASING", "RETREATING"])
def test_killed_with_the_plug_in_the_port_the_next_start_moves_nothing_until_asked(
    start: Start, tmp_path: Path, state: str
) -> None:
    first = start()
    if state in ("RELEASING", "RETREATING"):
        first.job(Request.DOCK)
    first.begin_until(Request.UNDOCK if state in ("RELEASING", "RETREATING") else Request.DOCK, state)
    time.sleep(0.1)
    first.signal(signal.SIGKILL)
    first.ended()
    second = start()
    status = second.status()
    assert motions(second) == []
    if status["state"] == "FAULT":
        assert status["fault"] == "plug-inserted-at-start" and "undock" in status["remedy"]
        assert second.job(Request.UNDOCK).outcome == "undocked"
    elif status["state"] == "CHARGING":
        assert second.job(Request.UNDOCK).outcome == "undocked"
    else:  # the plug was not in yet, or out already
        assert status["state"] == "READY"
        assert second.job(Request.UNDOCK).outcome in (
            "already-undocked",
            "undocked",
        )  # the latter where it stood before it


def test_killed_while_charging_the_next_start_observes_and_an_undock_takes_the_plug_out(start: Start) -> None:
    first = start()
    first.job(Request.DOCK)
    first.signal(signal.SIGKILL)
    first.ended()
    second = start()
    assert second.status()["state"] == "CHARGING" and motions(second) == []
    assert second.job(Request.UNDOCK).outcome == "undocked"
    assert not second.world()["power"] and second.world()["lock"] == PlugLock.UNLOCKED
