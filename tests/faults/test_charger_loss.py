"""The charger falls silent: what the controller does in each of its states, and that nothing ever goes on by itself.

The table is that of docs/can.md. Stand-ins for the devices; mission, supervisor and gate are the real ones.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.commands import BackOff
from controller.faults import FaultCode, Outcome
from controller.safety import check
from controller.situation import Situation
from controller.states import Event, State, next_state
from drivers.base import ChargerRequest, MotionProgress, SafetyMode
from perception.geometry import Pose
from tests.unit.mission_rig import Rig

PASSED = [
    State.SELF_CHECK, State.STAGING, State.SCANNING, State.LOCATING, State.APPROACHING, State.INSERTING,
    State.VERIFYING, State.CHARGING, State.RELEASING, State.RETREATING,
]  # fmt: skip
"""States that a cycle passes. The others have tests of their own below; together they are all there are."""
ELSEWHERE = {State.OFFLINE, State.READY, State.HOLD, State.FAULT}
MOTIONS = {"move_joints", "move_linear", "move_velocity", "comply"}


class Silence:
    """Makes the charger silent and notes what has been done until then."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.moves = self.requests = self.poses = -1

    def __call__(self) -> None:
        self.moves, self.requests = len(self._rig.arm.moves), len(self._rig.charger.requests)
        self._rig.charger.lost = True

    @property
    def moves_after(self) -> list[str]:
        return self._rig.arm.moves[self.moves :]

    @property
    def requests_after(self) -> list[ChargerRequest]:
        return self._rig.charger.requests[self.requests :]


def test_every_state_is_looked_at() -> None:
    assert set(PASSED) | ELSEWHERE == set(State)


@pytest.mark.parametrize("state", PASSED)
def test_the_arm_stops_and_holds_and_the_charger_is_told_to_abort(tmp_path: Path, state: State) -> None:
    rig = _rig(tmp_path)
    silence = Silence(rig)
    rig.at(state.name, silence)
    outcome = rig.run()
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.CHARGER_LINK_LOST
    assert rig.mission.state is State.FAULT
    assert "stop" in silence.moves_after
    assert not MOTIONS & set(silence.moves_after), "not even a live plug's way out"
    assert silence.requests_after[-1] is ChargerRequest.ABORT
    assert not {ChargerRequest.UNLOCK_PLUG, ChargerRequest.ENABLE_POWER} & set(silence.requests_after)
    assert rig.charger.poses[-1:] in ([None], []), "no pose is announced any more"


@pytest.mark.parametrize("state", PASSED)
def test_a_charger_that_is_back_resumes_nothing(tmp_path: Path, state: State) -> None:
    rig = _rig(tmp_path)
    silence = Silence(rig)
    rig.at(state.name, silence)
    rig.supervisor.start()
    try:
        rig.mission.run()
        rig.charger.lost = False
        _ticks(rig, 2)  # the tick that tripped has ended, with its own stop of the arm
        moves, kicks = len(rig.arm.moves), rig.arm.kicks
        _ticks(rig, 20)
        assert rig.supervisor.trip is not None
        assert rig.mission.state is State.FAULT
        assert len(rig.arm.moves) == moves
        assert rig.arm.kicks == kicks, "the arm's own watchdog keeps it stopped"
        assert rig.charger.beats[-1].mode == 15
        assert rig.charger.beats[-1].state == State.FAULT
        assert next_state(State.FAULT, Event.RESUMED) is State.FAULT
    finally:
        rig.supervisor.close()


def test_a_mission_on_hold_ends_too_and_nothing_moves(tmp_path: Path) -> None:
    rig = _rig(tmp_path)
    silence = Silence(rig)

    def on_state(name: str) -> None:
        if name == "SCANNING":
            rig.arm.safety = SafetyMode.SAFEGUARD_STOP  # a person in the zone
        if name == "HOLD":
            silence()

    rig.watch.on_state = on_state
    outcome = rig.run()
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.CHARGER_LINK_LOST
    assert rig.watch.states[-2:] == ["HOLD", "FAULT"]
    assert not MOTIONS & set(silence.moves_after)
    assert silence.requests_after[-1] is ChargerRequest.ABORT


@pytest.mark.parametrize("state", [State.READY, State.HOLD])
def test_at_rest_the_loss_trips_too(tmp_path: Path, state: State) -> None:
    rig = _rig(tmp_path)
    rig.supervisor.enter(state, None)
    rig.supervisor.start()
    try:
        _ticks(rig, 3)
        assert rig.supervisor.trip is None
        rig.charger.lost = True
        _until(lambda: rig.supervisor.trip is not None)
        assert rig.supervisor.trip is not None
        assert rig.supervisor.trip.code is FaultCode.CHARGER_LINK_LOST
    finally:
        rig.supervisor.close()


@pytest.mark.parametrize("state", [State.OFFLINE, State.FAULT])
def test_where_nothing_is_under_way_there_is_nothing_to_trip(tmp_path: Path, state: State) -> None:
    rig = _rig(tmp_path)
    rig.charger.lost = True
    rig.supervisor.enter(state, None)
    rig.supervisor.start()
    try:
        _ticks(rig, 10)
        assert rig.supervisor.trip is None
        assert rig.arm.kicks == 0
    finally:
        rig.supervisor.close()


# --- approaching: the one motion that goes on -------------------------------------------------------------------------


class Approach:
    """A mission whose charger falls silent while the arm is on its last way to the port."""

    def __init__(self, folder: Path, force_n: float = 0.0) -> None:
        self.rig = _rig(folder)
        self.force_n = force_n
        self.travelling = False
        self.backing_off = threading.Event()
        self.on_back_off: Callable[[], None] = self._arrive
        arm, state, move = self.rig.arm, self.rig.arm.state, self.rig.arm.move_linear
        travels: list[Pose] = []

        def move_linear(target: Pose, speed: float, acceleration: float) -> int:
            travels.append(target)
            number = move(target, speed, acceleration)
            if len(travels) == 2:  # to pre-contact: still on the way when the charger falls silent
                self.travelling = self.rig.charger.lost = True
                self.kicks_before = arm.kicks
            elif len(travels) == 3:
                self.travelling = True
                self.backing_off.set()
                self.on_back_off()
            return number

        def stop(deceleration: float = 1.0) -> None:
            arm.moves.append("stop")
            self.travelling = False

        arm.move_linear = move_linear  # type: ignore[method-assign]
        arm.stop = stop  # type: ignore[method-assign]
        arm.motion = lambda: MotionProgress(1, running=self.travelling, failed=False, detail="")  # type: ignore[method-assign]
        arm.state = lambda: replace(state(), wrench=np.array([0, 0, self.force_n, 0, 0, 0]))  # type: ignore[method-assign]
        self.travels = travels

    def _arrive(self) -> None:
        self.travelling = False

    def run(self) -> Outcome:
        return self.rig.run()


def test_out_of_contact_the_arm_backs_out_on_its_axis_and_then_latches(tmp_path: Path) -> None:
    approach = Approach(tmp_path)
    outcome = approach.run()
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.CHARGER_LINK_LOST
    assert len(approach.travels) == 3
    assert approach.travels[2].distance_to(approach.travels[0]) == 0.0, "to the retreat pose"
    assert approach.rig.watch.states[-1] == "FAULT", "entered when the motion has ended"
    assert approach.rig.charger.requests[-1] is ChargerRequest.ABORT


def test_with_force_on_the_plug_the_arm_holds(tmp_path: Path) -> None:
    approach = Approach(tmp_path, force_n=10.5)
    outcome = approach.run()
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.CHARGER_LINK_LOST
    assert len(approach.travels) == 2
    assert any("BackOff: contact" in refusal for refusal in approach.rig.decisions.refused)


def test_while_backing_off_the_watchdog_is_kicked_and_anything_else_stops_the_arm(tmp_path: Path) -> None:
    approach = Approach(tmp_path)
    arm = approach.rig.arm
    kicks: list[int] = []

    def then_a_protective_stop() -> None:
        def later() -> None:
            begin = arm.kicks
            _until(lambda: arm.kicks > begin + 3)
            kicks.append(arm.kicks - begin)
            arm.safety = SafetyMode.PROTECTIVE_STOP

        threading.Thread(target=later, daemon=True).start()

    approach.on_back_off = then_a_protective_stop
    outcome = approach.run()
    assert kicks and kicks[0] > 3
    _until(lambda: not approach.travelling)  # stopped
    assert outcome.fault is not None
    assert outcome.fault.code is FaultCode.CHARGER_LINK_LOST, "the first trip stays"


def test_the_arm_backs_off_only_after_the_stop_of_the_trip_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    approach = Approach(tmp_path)
    rig, stop = approach.rig, approach.rig.arm.stop
    stopped_after: list[int] = []

    def late_stop(deceleration: float = 1.0) -> None:
        if threading.current_thread() is rig.supervisor._thread:
            approach.backing_off.wait(0.2)  # which must not come before this stop
            stopped_after.append(len(approach.travels))
        stop(deceleration)

    monkeypatch.setattr(rig.arm, "stop", late_stop)
    approach.run()
    assert len(approach.travels) == 3
    assert stopped_after == [2], "not the third travel, which is the way out"


@pytest.mark.parametrize("state", [state for state in State if state is not State.APPROACHING])
def test_the_gate_lets_the_arm_back_off_in_no_other_state(tmp_path: Path, state: State) -> None:
    rig = _rig(tmp_path)
    port = rig.arm.T_base_port
    out = rig.arm.pose
    near = Pose(out.rotation, port.translation + 0.1 * (out.translation - port.translation))
    command = BackOff(out, 0.05, 0.3)
    arm = replace(rig.arm.state(), T_base_tcp=near)
    assert check(command, Situation(State.APPROACHING, arm, None, port), rig.cell.limits) is None
    assert check(command, Situation(state, arm, None, port), rig.cell.limits) is not None


@pytest.mark.parametrize(
    "command",
    [
        lambda near, out: BackOff(near @ Pose(np.eye(3), np.array([0.0, 0.0, 0.01])), 0.05, 0.3),  # inwards
        lambda near, out: BackOff(out @ Pose(np.eye(3), np.array([0.003, 0.0, 0.0])), 0.05, 0.3),  # sideways
        lambda near, out: BackOff(out, 0.5, 0.3),  # too fast
        lambda near, out: BackOff(Pose(out.rotation, np.array([np.nan, 0.0, 0.0])), 0.05, 0.3),
    ],
)
def test_the_gate_lets_the_arm_back_off_only_straight_out_and_slowly(
    tmp_path: Path, command: Callable[[Pose, Pose], BackOff]
) -> None:
    rig = _rig(tmp_path)
    port, out = rig.arm.T_base_port, rig.arm.pose
    near = Pose(out.rotation, port.translation + 0.1 * (out.translation - port.translation))
    arm = replace(rig.arm.state(), T_base_tcp=near)
    assert check(command(near, out), Situation(State.APPROACHING, arm, None, port), rig.cell.limits) is not None


def _rig(folder: Path) -> Rig:
    """A stalled test machine is not the subject."""
    rig = Rig(folder)
    rig.supervisor._stall_s = 60.0
    return rig


def _ticks(rig: Rig, count: int) -> None:
    """So many ticks, tripped or not."""
    begin = rig.supervisor._ticks
    _until(lambda: rig.supervisor._ticks >= begin + count)


def _until(condition: Callable[[], object], timeout_s: float = 10.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "never happened"
        time.sleep(0.002)
