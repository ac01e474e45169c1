"""The real ur_rtde library against the emulated controller, over TCP, each in its own process.

Time-outs of this file are emulated time wherever the mock can be asked; nothing asserts on the wall clock.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from dashboard_client import DashboardClient
from rtde_control import Path as RtdePath
from rtde_control import PathEntry, RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

from mocks.world.blackboard import Blackboard
from perception.geometry import Pose
from tests.contract.ur_mock_process import (
    T_BASE_PORT,
    T_FLANGE_TCP,
    MockUr,
    make_world,
    run_client,
    start_client,
    still,
)

HZ = 125.0
HOME = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]


class Robot:
    """A mock and the clients connected to it."""

    def __init__(self, mock: MockUr) -> None:
        self.mock = mock
        self.control = RTDEControlInterface(mock.host, HZ)
        self.receive = RTDEReceiveInterface(mock.host, HZ)

    def ready(self) -> Robot:
        """Back to a running script at home, whatever the last test left."""
        runs = self.mock.state()["runtime"] == "PLAYING"
        wait_until(lambda: self.control.isProgramRunning() == runs)
        if not runs:
            self.control.reuploadScript()
            wait_until(self.control.isProgramRunning)
        assert self.control.moveJ(HOME, 3.0, 10.0)
        return self

    def close(self) -> None:
        self.control.disconnect()
        self.receive.disconnect()


def wait_until(holds: Callable[[], bool], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.fixture(scope="module")
def shared() -> Iterator[Robot]:
    with MockUr("--time-scale", "3") as mock:
        robot = Robot(mock)
        yield robot
        robot.close()


@pytest.fixture
def robot(shared: Robot) -> Robot:
    return shared.ready()


# --- motion ---------------------------------------------------------------------------------------------------------


def test_a_blocking_linear_move_arrives(robot: Robot) -> None:
    target = robot.receive.getActualTCPPose()
    target[2] += 0.05
    assert robot.control.moveL(target, 0.5, 2.0)
    assert robot.mock.state()["tcp"] == pytest.approx(target, abs=1e-6)


def test_an_asynchronous_move_tells_its_progress_and_a_new_operation(robot: Robot) -> None:
    target = robot.receive.getActualTCPPose()
    target[1] += 0.05
    before = robot.control.getAsyncOperationProgressEx()
    assert robot.control.moveL(target, 0.2, 1.0, True)
    running = robot.control.getAsyncOperationProgressEx()
    assert running.isAsyncOperationRunning()
    assert running.operationId() == before.operationId() + 1
    wait_until(lambda: not robot.control.getAsyncOperationProgressEx().isAsyncOperationRunning())
    assert robot.control.getAsyncOperationProgressEx().operationId() == running.operationId()
    assert robot.mock.state()["tcp"] == pytest.approx(target, abs=1e-6)


def test_stopping_an_asynchronous_move_leaves_the_arm_short_of_its_target(robot: Robot) -> None:
    target = robot.receive.getActualTCPPose()
    target[2] += 0.2
    robot.control.moveL(target, 0.1, 1.0, True)
    robot.mock.until(lambda state: abs(state["tool_speed"][2]) > 0.05)
    robot.control.stopL(2.0, True)
    state = robot.mock.until(still)
    assert state["tcp"][2] < target[2] - 0.05


def test_tool_velocity_and_its_stop(robot: Robot) -> None:
    assert robot.control.speedL([0.0, 0.02, 0.0, 0.0, 0.0, 0.0], 0.5)
    state = robot.mock.until(lambda state: abs(state["tool_speed"][1] - 0.02) < 1e-4)
    assert state["runtime"] == "PLAYING"
    assert robot.control.speedStop(10.0)
    assert still(robot.mock.state())


def test_joint_paths_and_mixed_paths_reach_their_last_point(robot: Robot) -> None:
    end = [0.1, -1.5, 1.5, -1.5, -1.5, 0.0]
    fast = [3.0, 10.0, 0.0]
    assert robot.control.moveJ([[*HOME, *fast], [*end, *fast]], False)
    assert robot.mock.state()["q"] == pytest.approx(end)
    path = RtdePath()
    pose = robot.receive.getActualTCPPose()
    pose[2] += 0.03
    path.addEntry(PathEntry(PathEntry.MoveJ, PathEntry.PositionJoints, [*end, *fast]))
    path.addEntry(PathEntry(PathEntry.MoveL, PathEntry.PositionTcpPose, [*pose, 0.5, 2.0, 0.0]))
    assert robot.control.movePath(path, True)
    robot.mock.until(lambda state: np.allclose(state["tcp"], pose, atol=1e-6))


def test_servo_follows_joint_targets(robot: Robot) -> None:
    for k in range(30):
        robot.control.servoJ([HOME[0] + 0.001 * k, *HOME[1:]], 0.5, 0.5, 0.008, 0.1, 300)
    robot.mock.until(lambda state: abs(state["q"][0] - 0.029) < 1e-3)
    assert robot.control.servoStop(10.0)


def test_a_pose_out_of_reach_ends_the_script_and_moves_nothing(robot: Robot) -> None:
    before = robot.mock.state()
    assert not robot.control.moveL([3.0, 0.0, 0.5, 0.0, 0.0, 0.0], 0.5, 1.0)
    state = robot.mock.state()
    assert (state["runtime"], state["q"]) == ("STOPPED", pytest.approx(before["q"]))
    assert not robot.control.moveL(before["tcp"], 0.5, 1.0)


# --- questions and settings -------------------------------------------------------------------------------------------


def test_kinematics_tcp_and_payload_by_command(robot: Robot) -> None:
    control = robot.control
    assert control.setTcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert control.getTCPOffset() == pytest.approx([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    pose = control.getForwardKinematics()
    assert control.getInverseKinematics(pose) == pytest.approx(HOME, abs=1e-6)
    assert control.getInverseKinematicsHasSolution(pose)
    assert not control.getInverseKinematicsHasSolution([3.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    assert control.setPayload(1.5, [0.0, 0.0, 0.05])
    wait_until(lambda: robot.receive.getPayload() == pytest.approx(1.5))
    assert control.isSteady()
    assert control.setTcp([0.0] * 6)


def test_a_custom_script_runs_and_the_control_script_comes_back(robot: Robot) -> None:
    script = "movej([0.05,-1.5,1.5,-1.5,-1.5,0.0], a=10, v=3)\nset_digital_out(2, True)"
    assert robot.control.sendCustomScriptFunction("wave", script)
    assert robot.mock.state()["q"][0] == pytest.approx(0.05)
    wait_until(lambda: robot.receive.getDigitalOutState(2))
    assert robot.control.isProgramRunning()


def test_inputs_and_outputs_by_the_io_interface(robot: Robot) -> None:
    io = RTDEIOInterface(robot.mock.host)
    assert io.setStandardDigitalOut(5, True) and io.setToolDigitalOut(0, True)
    wait_until(lambda: robot.receive.getDigitalOutState(5) and robot.receive.getDigitalOutState(16))
    assert io.setSpeedSlider(0.4)
    wait_until(lambda: robot.receive.getTargetSpeedFraction() == pytest.approx(0.4))
    assert io.setSpeedSlider(1.0)
    io.disconnect()


def test_the_dashboard_speaks_as_ur_rtde_expects(robot: Robot) -> None:
    dashboard = DashboardClient(robot.mock.host)
    dashboard.connect()
    assert dashboard.isConnected() and dashboard.isInRemoteControl() and dashboard.running()
    assert dashboard.polyscopeVersion() == "5.15.0.0"
    assert dashboard.getSerialNumber().isdigit()
    assert dashboard.getRobotModel().startswith("UR10")
    assert dashboard.robotmode() == "Robotmode: RUNNING"
    assert dashboard.safetystatus() == "Safetystatus: NORMAL"
    assert dashboard.programState() == "PLAYING rtde_control"
    with pytest.raises(RuntimeError, match="File not found"):
        dashboard.loadURP("nothing.urp")
    dashboard.disconnect()


# --- what must stop the arm -------------------------------------------------------------------------------------------


def test_a_watchdog_that_nobody_kicks_stops_program_and_arm(robot: Robot) -> None:
    assert robot.control.setWatchdog(10.0)
    robot.control.speedL([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], 0.5)
    state = robot.mock.until(lambda state: state["runtime"] == "STOPPED" and still(state))
    assert state["program"] is None
    wait_until(lambda: not robot.control.isProgramRunning())
    assert not robot.control.speedL([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], 0.5)


def test_a_watchdog_that_is_kicked_lets_the_motion_finish(robot: Robot) -> None:
    target = robot.receive.getActualTCPPose()
    target[2] += 0.05
    assert robot.control.setWatchdog(1.0)
    robot.control.moveL(target, 0.05, 0.5, True)
    while robot.control.getAsyncOperationProgressEx().isAsyncOperationRunning():
        assert robot.control.kickWatchdog()
        time.sleep(0.02)
    assert robot.mock.state()["tcp"] == pytest.approx(target, abs=1e-6)
    robot.control.stopScript()


def test_a_protective_stop_fails_the_move_and_play_would_resume_it(robot: Robot) -> None:
    target = robot.receive.getActualTCPPose()
    target[2] += 0.1
    robot.control.moveL(target, 0.05, 0.5, True)
    robot.mock.until(lambda state: state["tool_speed"][2] > 0.04)
    robot.mock.do("protective_stop")
    held = robot.mock.until(still)
    assert (held["runtime"], held["safety"]) == ("PAUSED", "PROTECTIVE_STOP")
    wait_until(robot.receive.isProtectiveStopped)
    assert not robot.control.moveL(target, 0.05, 0.5)
    dashboard = DashboardClient(robot.mock.host)
    dashboard.connect()
    with pytest.raises(RuntimeError, match="Cannot unlock"):
        dashboard.unlockProtectiveStop()
    robot.mock.until(lambda state: state["time_s"] > held["time_s"] + 5.1)
    dashboard.unlockProtectiveStop()
    assert robot.mock.state()["tcp"] == pytest.approx(held["tcp"], abs=1e-9)
    dashboard.play()
    robot.mock.until(lambda state: state["tcp"] == pytest.approx(target, abs=1e-6))
    dashboard.stop()
    dashboard.disconnect()


def test_an_emergency_stop_drops_power_until_it_is_given_back(robot: Robot) -> None:
    robot.control.speedL([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], 0.5)
    robot.mock.do("estop")
    state = robot.mock.state()
    assert still(state) and (state["power"], state["runtime"]) == ("POWER_OFF", "STOPPED")
    wait_until(robot.receive.isEmergencyStopped)
    robot.mock.do("release_estop")
    dashboard = DashboardClient(robot.mock.host)
    dashboard.connect()
    dashboard.closeSafetyPopup()
    dashboard.powerOn()
    dashboard.brakeRelease()
    wait_until(lambda: robot.receive.getRobotMode() == 7)
    dashboard.disconnect()


def test_a_safeguard_stop_holds_the_arm_only_while_the_gate_is_open(robot: Robot) -> None:
    robot.control.speedL([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], 0.5)
    robot.mock.do("safeguard", open=True)
    robot.mock.until(still)
    wait_until(lambda: robot.receive.getSafetyMode() == 5)
    robot.mock.do("safeguard", open=False)
    robot.mock.until(lambda state: not still(state))
    robot.control.speedStop(10.0)


# --- clients that may hang or die: each in a process of its own -------------------------------------------------------

CONNECT = """
import sys
from rtde_control import RTDEControlInterface
try:
    RTDEControlInterface(sys.argv[1], 125.0)
    print("connected")
except RuntimeError as error:
    print(error)
"""
SPEEDL = """
import sys, time
from rtde_control import RTDEControlInterface
control = RTDEControlInterface(sys.argv[1], 125.0)
if "WATCHDOG": control.setWatchdog(10.0)
control.speedL([0, 0, 0.02, 0, 0, 0], 0.5)
while True:
    time.sleep(0.01)
    control.kickWatchdog()
"""
SHORT_VECTOR = """
import sys
from rtde_control import RTDEControlInterface
control = RTDEControlInterface(sys.argv[1], 125.0)
print("connected", flush=True)
control.moveL([0.1, 0.2, 0.3, 0.0, 0.0], 0.25, 1.2)
"""


@pytest.fixture(scope="module")
def spare() -> Iterator[MockUr]:
    with MockUr() as mock:
        yield mock


@pytest.fixture
def lone(spare: MockUr) -> MockUr:
    """A controller for clients that come and go; the arm is at rest."""
    spare.do("stop")
    spare.until(still)
    return spare


def test_local_mode_and_taken_registers_are_told_by_the_constructor(lone: MockUr) -> None:
    lone.do("remote", on=False)
    assert "enable remote control" in run_client(CONNECT, lone.host).stdout
    lone.do("remote", on=True)
    lone.do("registers_in_use", names=["input_int_register_0"])
    assert "already in use" in run_client(CONNECT, lone.host).stdout
    lone.do("registers_in_use", names=[])
    assert "connected" in run_client(CONNECT, lone.host).stdout


def test_a_package_of_the_wrong_length_moves_nothing(lone: MockUr) -> None:
    before = lone.state()["q"]
    client = start_client(SHORT_VECTOR, lone.host)
    try:
        assert client.stdout is not None and client.stdout.readline() == "connected\n"
        since = lone.state()["time_s"]
        state = lone.until(lambda state: state["time_s"] > since + 1.0)
        assert state["q"] == pytest.approx(before) and state["runtime"] == "PLAYING"
        assert client.poll() is None  # the client library waits for an answer that cannot come
    finally:
        client.kill()
        client.communicate()


@pytest.mark.parametrize("watchdog", [True, False])
def test_after_the_client_is_killed_only_a_watchdog_stops_the_arm(lone: MockUr, watchdog: bool) -> None:
    client = start_client(SPEEDL.replace('"WATCHDOG"', str(watchdog)), lone.host)
    try:
        lone.until(lambda state: abs(state["tool_speed"][2] - 0.02) < 1e-4, 60.0)
    finally:
        client.kill()
        client.communicate()
    since = lone.state()["time_s"]
    state = lone.until(lambda state: state["time_s"] > since + 1.5)
    assert still(state) is watchdog


def test_a_lost_link_stops_the_arm_by_its_watchdog_whatever_becomes_of_the_client(lone: MockUr) -> None:
    """A mere reset or frozen data would not do: ur_rtde reconnects by itself, or goes on kicking on old data."""
    client = start_client(SPEEDL.replace('"WATCHDOG"', "True"), lone.host)
    try:
        lone.until(lambda state: abs(state["tool_speed"][2] - 0.02) < 1e-4, 60.0)
        lone.do("down", link="rtde")
        lone.until(still)
    finally:
        client.kill()
        client.communicate()
        lone.do("up", link="rtde")


def test_ports_that_are_down_refuse_and_come_back(lone: MockUr) -> None:
    lone.do("down", link="all")
    assert "verify the IP" in run_client(CONNECT, lone.host).stdout
    lone.do("up", link="all")
    assert "connected" in run_client(CONNECT, lone.host).stdout


def test_a_frozen_link_looks_alive_and_a_dropped_one_can_be_reopened(lone: MockUr) -> None:
    receive = RTDEReceiveInterface(lone.host, HZ)
    lone.do("freeze", seconds=0.3)
    stamp = receive.getTimestamp()
    wait_until(lambda: receive.getTimestamp() > stamp)
    lone.do("drop", link="rtde")
    wait_until(lambda: not receive.isConnected())
    assert receive.reconnect()
    stamp = receive.getTimestamp()
    wait_until(lambda: receive.getTimestamp() > stamp)
    receive.disconnect()


def test_a_second_mock_on_the_same_address_says_so_in_one_line(lone: MockUr, tmp_path: Path) -> None:
    for arguments in (["--host", lone.host], ["--host", "127.0.0.2", "--world", str(tmp_path)]):
        command = [sys.executable, "-m", "mocks.ur", *arguments]
        mock = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert (mock.returncode, mock.stdout) == (3, "")
        assert mock.stderr.startswith("mock arm: ") and mock.stderr.count("\n") == 1


def test_sigterm_ends_the_mock_in_good_order() -> None:
    with MockUr() as mock:
        mock.process.terminate()
        assert mock.process.wait(20.0) == 0


def test_two_controllers_live_side_by_side_and_a_newer_version_works(lone: MockUr) -> None:
    with MockUr("--version", "5.23.0.0", "--model", "ur5e") as other:
        newer, older = Robot(other), Robot(lone)
        assert newer.control.moveJ([0.2, *HOME[1:]], 3.0, 10.0) and older.control.moveJ([-0.2, *HOME[1:]], 3.0, 10.0)
        assert (other.state()["q"][0], lone.state()["q"][0]) == pytest.approx((0.2, -0.2))
        newer.close()
        older.close()


# --- the plug meets the port ------------------------------------------------------------------------------------------

PUSH = [0.0, 0.0, 60.0, 0.0, 0.0, 0.0]
LIMITS = [0.01, 0.01, 0.02, 0.05, 0.05, 0.05]


@contextlib.contextmanager
def pushing(folder: Path, error: Pose) -> Iterator[tuple[MockUr, Robot, Blackboard]]:
    """An arm that pushes the plug along the port's axis, yielding in all axes, off by ``error`` at the start."""
    board = make_world(folder, error, time_scale=3.0)
    with MockUr("--world", str(folder)) as mock:
        robot = Robot(mock)
        robot.control.setTcp(list(T_FLANGE_TCP.vector))
        robot.control.zeroFtSensor()
        task = Pose(T_BASE_PORT.rotation @ np.diag([1.0, -1.0, -1.0]), T_BASE_PORT.translation)
        robot.control.forceMode(list(task.vector), [1] * 6, PUSH, 2, LIMITS)
        yield mock, robot, board
        robot.close()


def test_a_compliant_push_within_capture_seats_the_plug_and_a_lock_holds_it(tmp_path: Path) -> None:
    with pushing(tmp_path, Pose.from_rotvec([0.02, 0.0, 0.02], [0.0012, -0.001, 0.0])) as (mock, robot, board):
        mock.until(lambda _: board.plug().seated)
        state = mock.until(lambda state: abs(np.linalg.norm(state["wrench"][:3]) - 60.0) < 4.0)
        assert state["peak_force_n"] < 75.0
        newest = board.latest_arm()
        assert newest is not None and newest[0] <= board.world_time_s()
        board.put_lock(True)
        pull = Pose(T_BASE_PORT.rotation, T_BASE_PORT.translation)
        robot.control.forceMode(list(pull.vector), [0, 0, 1, 0, 0, 0], PUSH, 2, LIMITS)
        since = state["time_s"]
        mock.until(lambda state: state["time_s"] > since + 2.0)
        assert board.plug().depth_m > 0.047
        board.put_lock(False)
        mock.until(lambda _: board.plug().depth_m < -0.001)
        assert robot.control.forceModeStop()


def test_a_push_outside_capture_ends_on_the_face(tmp_path: Path) -> None:
    with pushing(tmp_path, Pose.from_rotvec([0.0, 0.0, 0.0], [0.004, 0.0, 0.0])) as (mock, _, board):
        state = mock.until(lambda state: np.linalg.norm(state["wrench"][:3]) > 55.0)
        since = state["time_s"]
        mock.until(lambda state: state["time_s"] > since + 1.0)
        assert 0.0 < board.plug().depth_m < 0.005 and not board.plug().seated


def test_the_cells_emergency_stop_reaches_the_arm(tmp_path: Path) -> None:
    board = make_world(tmp_path, Pose.identity())
    with MockUr("--world", str(tmp_path)) as mock:
        board.put_estop(True)
        mock.until(lambda state: state["safety"] == "SYSTEM_EMERGENCY_STOP" and state["power"] == "POWER_OFF")
        board.put_estop(False)
        mock.until(lambda state: state["safety"] == "NORMAL")
