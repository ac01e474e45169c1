"""Opening the arm's link: every way in which a robot is not ready is its own error, and leaves nothing behind."""

from __future__ import annotations

import socket
import threading
import time

import pytest

from drivers.arm.dashboard import Dashboard
from drivers.arm.errors import (
    ArmAbsentError,
    ArmNotReadyError,
    ForeignProgramError,
    LocalModeError,
    ProgramStartError,
    ReadBackError,
    RegistersInUseError,
    SafetyStopError,
    WrongModelError,
    WrongSerialError,
)
from drivers.arm.ur import UrArm
from drivers.base import LinkLostError, LinkOpenError
from tests.arm_rig import MockController, own_address, settings, until


@pytest.fixture(scope="module")
def controller():
    made = MockController()
    yield made
    made.close()


@pytest.fixture
def mock(controller):
    """The one controller, in order again after each test."""
    yield controller
    controller.do("remote", on=True)
    controller.do("script_starts", on=True)
    controller.do("registers_in_use", names=[])
    controller.do("release_estop")
    controller.do("safety", mode="NORMAL")
    with Dashboard(controller.host) as dashboard:
        for command in ("stop", "power on", "brake release"):
            dashboard.ask(command)
        until(lambda: dashboard.robot_mode() == "RUNNING", "the controller is ready again")


def refused(error: type[LinkOpenError], host: str, **changes: object) -> LinkOpenError:
    """Open, expect this very error, and that nothing stays behind."""
    arm = UrArm(settings(host, **changes))
    threads = threading.active_count()
    with pytest.raises(error) as caught:
        arm.open()
    assert type(caught.value) is error
    assert "\n" not in caught.value.cause
    assert caught.value.remedy
    until(lambda: threading.active_count() <= threads, "its threads have ended")
    with pytest.raises(LinkLostError):
        arm.state()
    arm.close()
    return caught.value


def test_an_absent_robot_is_reported_soon() -> None:
    begun = time.monotonic()
    error = refused(ArmAbsentError, own_address())
    assert time.monotonic() - begun < 3.0
    assert "30004" in error.cause


def test_a_silent_host_does_not_freeze_this_process() -> None:
    host = own_address()
    ticks = 0
    running = threading.Event()
    running.set()

    def tick() -> None:
        nonlocal ticks
        while running.is_set():
            ticks += 1
            time.sleep(0.01)

    with socket.create_server((host, 30004)):  # accepts, and never says a word
        ticker = threading.Thread(target=tick)
        ticker.start()
        refused(ArmAbsentError, host)
        running.clear()
        ticker.join()
    assert ticks > 50


def test_something_else_at_the_port_is_no_robot() -> None:
    host = own_address()
    with socket.create_server((host, 30004)) as server:

        def answer() -> None:
            link, _ = server.accept()
            with link:
                link.recv(100)
                link.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        refused(ArmAbsentError, host)
        thread.join()


def test_opening_is_quick_and_closing_ends_the_script(mock) -> None:
    arm = UrArm(settings(mock.host))
    arm.open()
    assert arm.health().up
    assert mock.state()["program"] == "rtde_control"
    arm.close()
    assert mock.state()["program"] is None
    arm.close()  # again: nothing happens


def test_a_robot_in_local_mode(mock) -> None:
    mock.do("remote", on=False)
    assert "remote control" in refused(LocalModeError, mock.host).remedy


def test_another_model(mock) -> None:
    assert "UR10" in refused(WrongModelError, mock.host, model="ur5e").cause


def test_another_robot(mock) -> None:
    refused(WrongSerialError, mock.host, serial="20190000000")


def test_a_robot_without_power(mock) -> None:
    mock.do("estop")
    mock.do("release_estop")
    assert "POWER_OFF" in refused(ArmNotReadyError, mock.host).cause


@pytest.mark.parametrize("fault", ["protective_stop", "estop"])
def test_a_robot_that_is_stopped_for_safety_stays_so(mock, fault) -> None:
    mock.do(fault)
    refused(SafetyStopError, mock.host)
    assert mock.state()["safety"] != "NORMAL"


def test_registers_owned_by_someone_else(mock) -> None:
    mock.do("registers_in_use", names=["input_int_register_0"])
    assert "EtherNet/IP" in refused(RegistersInUseError, mock.host).remedy


def test_the_upper_registers_avoid_an_owner_of_the_lower_ones(mock) -> None:
    mock.do("registers_in_use", names=["input_int_register_0", "input_double_register_0"])
    arm = UrArm(settings(mock.host, upper_registers=True))
    arm.open()
    motion = arm.move_linear(arm.state().T_base_tcp.moved([0, 0, -0.01]), 0.1, 1.0)
    deadline = time.monotonic() + 10.0
    while arm.motion().running and time.monotonic() < deadline:
        arm.kick_watchdog()
        time.sleep(0.01)
    assert arm.motion().motion_id == motion
    assert not arm.motion().failed, arm.motion().detail
    arm.close()


def test_the_lower_registers_work_from_5_23_on() -> None:
    mock = MockController("--version", "5.23.0.0")
    try:
        arm = UrArm(settings(mock.host))
        arm.open()
        arm.move_linear(arm.state().T_base_tcp.moved([0, 0, -0.01]), 0.1, 1.0)
        deadline = time.monotonic() + 10.0
        while arm.motion().running and time.monotonic() < deadline:
            arm.kick_watchdog()
            time.sleep(0.01)
        assert not arm.motion().running
        assert not arm.motion().failed, arm.motion().detail
        arm.close()
    finally:
        mock.close()


@pytest.mark.slow
def test_a_control_script_that_does_not_start(mock) -> None:
    mock.do("script_starts", on=False)
    refused(ProgramStartError, mock.host)


def run_program(host: str) -> None:
    with socket.create_connection((host, 30003)) as link:
        link.sendall(b"def other():\n  sleep(60)\nend\n")


def test_a_running_program_of_someone_else_is_not_stopped_unasked(mock) -> None:
    run_program(mock.host)
    until(lambda: mock.state()["program"] == "other", "the other program runs")
    refused(ForeignProgramError, mock.host)
    assert mock.state()["program"] == "other"
    arm = UrArm(settings(mock.host, stop_running_program=True))
    arm.open()
    assert mock.state()["program"] == "rtde_control"
    arm.close()


def test_a_payload_that_the_controller_does_not_take(mock) -> None:
    # All zero means "keep the old centre of gravity" to the client library: the read-back finds it out.
    arm = UrArm(settings(mock.host))
    arm.open()
    arm.close()
    refused(ReadBackError, mock.host, centre_of_gravity_m=(0.0, 0.0, 0.0))
