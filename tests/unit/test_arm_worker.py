"""The control worker's rules, with a stand-in for ur_rtde's control interface and a real socket pair."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from multiprocessing.connection import Connection

import pytest

from drivers.arm import messages as m
from drivers.arm.control_loop import ControlLoop, LinkDeadError
from drivers.arm.errors import ControlLinkLostError
from drivers.arm.operation import Motion
from drivers.arm.worker_client import WorkerClient
from drivers.arm.worker_link import Link

POSE = (0.4, 0.1, 0.3, 0.0, 3.1, 0.0)
JOINTS = (0.1, -1.2, 1.3, -1.4, -1.5, 0.2)


class Operation:
    def __init__(self, number: int, running: bool) -> None:
        self.number, self.running = number, running

    def operationId(self) -> int:
        return self.number

    def isAsyncOperationRunning(self) -> bool:
        return self.running


class FakeControl:
    """Notes every call; a motion runs until the test ends it."""

    def __init__(self) -> None:
        self.calls: list[tuple] = []
        self.connected = True
        self.program = True
        self.operation = Operation(0, False)
        self.solution = list(JOINTS)
        self.accepts = True

    def __getattr__(self, name: str):
        def call(*arguments):
            self.calls.append((name, *arguments))
            return self.accepts

        return call

    def isConnected(self) -> bool:
        return self.connected

    def isProgramRunning(self) -> bool:
        return self.program

    def getAsyncOperationProgressEx(self) -> Operation:
        return self.operation

    def getInverseKinematics(self, pose, near):
        self.calls.append(("getInverseKinematics", pose, near))
        return self.solution

    def moveL(self, *arguments) -> bool:
        self.calls.append(("moveL", *arguments))
        if self.accepts:
            self.begin()
        return self.accepts

    def moveJ(self, *arguments) -> bool:
        self.calls.append(("moveJ", *arguments))
        self.begin()
        return True

    def stopL(self, *arguments) -> None:
        self.calls.append(("stopL", *arguments))
        self.begin()

    def begin(self) -> None:
        self.operation = Operation(self.operation.number + 1, True)

    def finish(self) -> None:
        self.operation = Operation(self.operation.number, False)

    def names(self) -> list[str]:
        return [call[0] for call in self.calls]


class Worker:
    """The loop in a thread, and the parent's end of its line."""

    def __init__(self, control: FakeControl) -> None:
        ours, theirs = socket.socketpair()
        self.line = Connection(ours.detach())
        self.control = control
        self.loop = ControlLoop(Link(Connection(theirs.detach())), control, 500.0, 5.0)
        self.error: BaseException | None = None
        self.status: m.Status | None = None
        self.number = 0
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        try:
            self.loop.run()
        except BaseException as error:  # handed to the test
            self.error = error

    def post(self, command) -> int:
        self.number += 1
        self.line.send(m.Request(self.number, command))
        return self.number

    def ask(self, command) -> m.Reply:
        number = self.post(command)
        return self.until(lambda message: isinstance(message, m.Reply) and message.number == number)

    def until(self, wanted, timeout_s: float = 5.0):
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self.line.poll(0.05):
                message = self.line.recv()
                if isinstance(message, m.Status):
                    self.status = message
                if wanted(message):
                    return message
        raise AssertionError("the worker did not say what was expected")

    def until_phase(self, phase: str) -> None:
        if self.status is None or self.status.phase != phase:
            self.until(lambda message: isinstance(message, m.Status) and message.phase == phase)

    def until_called(self, name: str, timeout_s: float = 5.0) -> None:
        deadline = time.monotonic() + timeout_s
        while name not in self.control.names():
            assert time.monotonic() < deadline, f"{name} was not called"
            time.sleep(0.002)


@pytest.fixture
def worker():
    made = Worker(FakeControl())
    yield made
    made.line.close()
    made.thread.join(5.0)
    assert not made.thread.is_alive()


def test_the_watchdog_is_set_before_the_first_motion_and_only_once(worker) -> None:
    assert worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5)).refusal == ""
    worker.control.finish()
    worker.until_phase("done")
    assert worker.ask(m.MoveLinear(2, POSE, 0.1, 0.5)).refusal == ""
    names = worker.control.names()
    assert names.count("setWatchdog") == 1
    assert names.index("setWatchdog") < names.index("moveL")


def test_nothing_is_kicked_unless_the_parent_asks(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    time.sleep(0.1)  # long enough for 50 rounds of the loop
    assert "kickWatchdog" not in worker.control.names()
    worker.line.send(m.Kick())
    worker.until_called("kickWatchdog")
    assert worker.control.names().count("kickWatchdog") == 1


def test_the_first_kick_sets_the_watchdog(worker) -> None:
    worker.line.send(m.Kick())
    worker.until_called("setWatchdog")
    assert worker.control.calls == [("setWatchdog", 5.0)]


def test_a_kick_within_a_mode_repeats_its_command_instead_of_wiping_it_out(worker) -> None:
    worker.ask(m.MoveVelocity((0.1, 0, 0, 0, 0, 0), 0.5))
    worker.ask(m.Comply(POSE, (0, 0, 1, 0, 0, 0), (0, 0, 20, 0, 0, 0), (0.05,) * 6))
    begun = len(worker.control.calls)
    deadline = time.monotonic() + 5.0
    while set(worker.control.names()[begun:]) != {"forceMode", "speedL"}:
        assert time.monotonic() < deadline
        worker.line.send(m.Kick())
        time.sleep(0.002)
    assert "kickWatchdog" not in worker.control.names()


def test_a_mode_that_has_just_begun_is_repeated_before_the_other_is_written_again(worker) -> None:
    worker.loop._pace._read_s = 0.3
    worker.ask(m.MoveVelocity((0.1, 0, 0, 0, 0, 0), 0.5))
    written = time.monotonic()
    worker.ask(m.Comply(POSE, (0, 0, 1, 0, 0, 0), (0, 0, 20, 0, 0, 0), (0.05,) * 6))
    assert time.monotonic() - written > 0.25, "the second mode waited until the first was read"
    worker.line.send(m.Kick())
    worker.ask(m.ZeroForceSensor())
    assert worker.control.names()[-3:] == ["forceMode", "forceMode", "zeroFtSensor"]


def test_a_stop_goes_before_a_kick_that_waits_with_it(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    worker.until_phase("running")
    worker.loop._pace._ready_at_s = time.monotonic() + 0.3  # both arrive while the worker waits for the script
    time.sleep(0.02)  # ten rounds of the loop: it waits by now
    worker.line.send(m.Kick())
    worker.ask(m.Stop(1.0, 0.1))
    worker.until_called("kickWatchdog")
    names = worker.control.names()
    assert names.index("stopL") < names.index("kickWatchdog")


def test_after_a_command_that_is_answered_the_script_gets_time_to_be_ready(worker) -> None:
    worker.loop._pace._get_ready_s = 0.2
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    answered_s = time.monotonic()
    worker.line.send(m.Kick())
    worker.until_called("kickWatchdog")
    assert time.monotonic() - answered_s > 0.15


def test_motions_are_asynchronous(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    assert worker.control.calls[-1] == ("moveL", list(POSE), 0.1, 0.5, True)


def test_a_joint_motion_uses_the_controllers_calibrated_joints(worker) -> None:
    worker.control.solution = [angle + 0.003 for angle in JOINTS]
    reply = worker.ask(m.MoveJoints(1, POSE, JOINTS, 0.5, 1.0))
    assert reply.joints == tuple(worker.control.solution)
    assert worker.control.calls[-1] == ("moveJ", worker.control.solution, 0.5, 1.0, True)


def test_another_branch_from_the_controller_is_refused(worker) -> None:
    worker.control.solution = [JOINTS[0] + 3.0, *JOINTS[1:]]
    assert worker.ask(m.MoveJoints(1, POSE, JOINTS, 0.5, 1.0)).refusal == "no-solution"
    assert "moveJ" not in worker.control.names()


def test_a_second_motion_is_refused_while_one_runs(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    assert worker.ask(m.MoveLinear(2, POSE, 0.1, 0.5)).refusal == "busy"
    assert worker.ask(m.MoveVelocity((0.01,) * 6, 0.5)).refusal == "busy"
    assert worker.control.names().count("moveL") == 1


def test_a_motion_is_done_when_its_operation_ends(worker) -> None:
    worker.ask(m.MoveLinear(7, POSE, 0.1, 0.5))
    worker.until_phase("running")
    worker.control.finish()
    worker.until_phase("done")
    assert worker.status == m.Status(True, 7, "done")


def test_a_motion_fails_when_the_script_ends(worker) -> None:
    worker.ask(m.MoveLinear(7, POSE, 0.1, 0.5))
    worker.control.program = False
    worker.until_phase("failed")
    assert worker.status == m.Status(False, 7, "failed")


def test_a_motion_that_never_begins_fails() -> None:
    motion = Motion(3, "running", operation_before=4)
    assert motion.advanced(Operation(4, False), True).phase == "running"
    motion._since_s -= 2.0
    assert motion.advanced(Operation(4, False), True).phase == "failed"


def test_stop_ends_a_motion_with_an_asynchronous_stop(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    worker.ask(m.Stop(1.5, 0.1))
    assert worker.control.calls[-1] == ("stopL", 1.5, True)
    worker.until_phase("stopping")
    worker.control.finish()
    worker.until_phase("done")
    assert "forceModeStop" not in worker.control.names()
    assert "speedStop" not in worker.control.names()


def test_stop_at_speed_decelerates_without_blocking_and_then_ends_the_mode(worker) -> None:
    worker.ask(m.MoveVelocity((0.1, 0, 0, 0, 0, 0), 0.5))
    worker.ask(m.Stop(1.0, 0.1))
    assert worker.control.calls[-1] == ("speedL", [0.0] * 6, 1.0, 0.0)
    worker.until_called("speedStop")


def test_stop_at_creep_speed_ends_the_mode_at_once(worker) -> None:
    worker.ask(m.MoveVelocity((0.01, 0, 0, 0, 0, 0), 0.5))
    worker.ask(m.Stop(1.0, 0.01))
    assert worker.control.calls[-1] == ("speedStop", 1.0)


def test_stop_in_force_mode_ends_the_motion_before_the_force(worker) -> None:
    worker.ask(m.Comply(POSE, (0, 0, 1, 0, 0, 0), (0, 0, 20, 0, 0, 0), (0.05,) * 6))
    worker.ask(m.MoveVelocity((0.0, 0.1, 0, 0, 0, 0), 0.5))
    worker.ask(m.Stop(1.0, 0.1))
    assert worker.control.names()[-2:] == ["speedStop", "forceModeStop"]


def test_stop_ends_force_mode_only_after_the_moves_stop_has_finished(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    worker.ask(m.Comply(POSE, (0, 0, 1, 0, 0, 0), (0, 0, 20, 0, 0, 0), (0.05,) * 6))
    worker.ask(m.Stop(1.0, 0.1))
    assert "forceModeStop" not in worker.control.names()
    worker.control.finish()
    worker.until_called("forceModeStop")


def test_stop_at_rest_calls_nothing(worker) -> None:
    assert worker.ask(m.Stop(1.0, 0.0)).refusal == ""
    assert worker.control.calls == []


def test_a_new_motion_waits_for_the_stop_and_kicks_still_pass(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    worker.ask(m.Stop(1.0, 0.1))
    number = worker.post(m.MoveLinear(2, POSE, 0.1, 0.5))
    worker.line.send(m.Kick())
    worker.until_called("kickWatchdog")
    assert worker.control.names().count("moveL") == 1
    worker.control.finish()
    assert worker.until(lambda message: isinstance(message, m.Reply) and message.number == number).refusal == ""
    assert worker.control.names().count("moveL") == 2


def test_a_refusal_says_that_the_program_is_not_running(worker) -> None:
    worker.control.accepts = False
    assert worker.ask(m.ZeroForceSensor()).refusal == "refused"
    worker.control.program = False
    assert worker.ask(m.ZeroForceSensor()).refusal == "program-stopped"


def test_an_argument_that_the_library_rejects_is_a_refusal_not_a_crash(worker) -> None:
    def raises(*_):
        raise ValueError("The value is not within [0;3]")

    worker.control.moveL = raises
    reply = worker.ask(m.MoveLinear(1, POSE, 4.0, 0.5))
    assert reply.refusal == "refused"
    assert "not within" in reply.detail


def test_a_lost_link_ends_the_loop_before_the_library_can_reconnect(worker) -> None:
    worker.ask(m.MoveLinear(1, POSE, 0.1, 0.5))
    worker.control.connected = False
    worker.thread.join(5.0)
    assert isinstance(worker.error, LinkDeadError)


def test_leaving_stops_what_moves_and_ends_the_script(worker) -> None:
    worker.ask(m.MoveVelocity((0.1, 0, 0, 0, 0, 0), 0.5))
    worker.post(m.Quit())
    worker.thread.join(5.0)
    assert worker.error is None
    assert worker.control.names()[-2:] == ["speedStop", "stopScript"]


def test_the_parents_end_raises_out_of_the_loop(worker) -> None:
    worker.line.close()
    worker.thread.join(5.0)
    assert isinstance(worker.error, EOFError)


def test_a_stop_overtakes_requests_that_wait() -> None:
    ours, theirs = socket.socketpair()
    line, link = Connection(ours.detach()), Link(Connection(theirs.detach()))
    line.send(m.Request(1, m.MoveLinear(1, POSE, 0.1, 0.5)))
    line.send(m.Request(2, m.Stop(1.0, 0.0)))
    link.fill(1.0)
    request = link.take_request()
    assert request is not None
    assert request.number == 2
    assert line.recv() == m.Reply(1, "refused", "stopped before it began")


def test_patience_stretches_the_wait_for_an_answer():
    client = WorkerClient(on_lost=lambda _: None, patience=3.0)  # never started, so it answers nothing
    with pytest.raises(ControlLinkLostError, match=r"no answer to Stop within 0\.3 s"):
        client.ask(m.Stop(1.0, 0.0), timeout_s=0.1)
    client.quit()


def test_kicks_that_a_worker_does_not_read_block_neither_the_tick_nor_its_end():
    client = WorkerClient(on_lost=lambda _: None, patience=1000.0)
    client._started = m.Started(())
    os.kill(client.pid, signal.SIGSTOP)
    begun = time.monotonic()
    for _ in range(5000):
        client.kick()
    client.quit()
    assert time.monotonic() - begun < 30.0  # 1.5 on a quiet machine


def test_before_the_worker_has_started_no_kick_comes_before_its_orders():
    client = WorkerClient(on_lost=lambda _: None, patience=1.0)
    client.kick()
    answer = client.start(m.Start("127.0.0.1", 125.0, False, 10.0, (0.0,) * 6, 1.0, (0.0,) * 3), 30.0)
    assert isinstance(answer, m.StartFailed)
    assert "Kick" not in answer.reason
    client.quit()
