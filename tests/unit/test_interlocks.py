"""What the interlocks decide at each tick: which fault trips, in which states, and what only pauses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.faults import FaultCode
from controller.interlocks import MOVING_STATES, PAUSABLE_STATES, Snapshot, assess, pause_reason
from controller.states import State
from drivers.base import ArmState, ChargerState, ChargerStatus, Pilot, PlugLock, Proximity, RobotMode, SafetyMode
from perception.geometry import Pose

ARM = ArmState(
    time_s=0.0,
    device_time_s=0.0,
    T_base_tcp=Pose.identity(),
    T_flange_tcp=Pose.identity(),
    joints=np.zeros(6),
    tcp_speed=np.zeros(6),
    wrench=np.zeros(6),
    mode=RobotMode.RUNNING,
    safety=SafetyMode.NORMAL,
    moving=False,
    program_running=True,
    speed_scaling=1.0,
)
CHARGER = ChargerStatus(
    time_s=0.0,
    state=ChargerState.READY,
    proximity=Proximity.ABSENT,
    pilot=Pilot.A,
    lock=PlugLock.UNLOCKED,
    contactor_closed=False,
    dock_enable=True,
    motion_inhibit=False,
    estop=False,
    fault_code=0,
    voltage_v=0.0,
    current_a=0.0,
    electrical_time_s=0.0,
)
GOOD = Snapshot(
    state=State.INSERTING,
    arm=ARM,
    arm_problem="",
    charger=CHARGER,
    charger_problem="",
    scanner_up=True,
    scanner_problem="",
    overdue="",
    late_s=0.0,
)
POWERED = [state for state in State if state not in (State.OFFLINE, State.FAULT)]


def code(seen: Snapshot) -> FaultCode | None:
    fault = assess(seen)
    return None if fault is None else fault.code


def with_arm(seen: Snapshot, **changes: object) -> Snapshot:
    return replace(seen, arm=replace(ARM, **changes))  # type: ignore[arg-type]


def with_charger(seen: Snapshot, **changes: object) -> Snapshot:
    return replace(seen, charger=replace(CHARGER, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("state", POWERED)
def test_nothing_trips_while_all_is_well(state: State) -> None:
    assert assess(replace(GOOD, state=state)) is None


@pytest.mark.parametrize("state", POWERED)
def test_a_lost_arm_or_charger_trips_in_every_powered_state(state: State) -> None:
    arm = assess(replace(GOOD, state=state, arm=None, arm_problem="silent for 0.2 s"))
    assert arm is not None and arm.code is FaultCode.ARM_LINK_LOST and "silent" in arm.detail
    assert code(replace(GOOD, state=state, charger=None)) is FaultCode.CHARGER_LINK_LOST


def test_a_lost_scanner_trips_only_where_it_is_needed() -> None:
    tripped = {s for s in POWERED if code(replace(GOOD, state=s, scanner_up=False)) is FaultCode.SCANNER_LINK_LOST}
    assert tripped == {State.STAGING, State.SCANNING}


@pytest.mark.parametrize("state", POWERED)
@pytest.mark.parametrize("mode", [SafetyMode.ROBOT_ESTOP, SafetyMode.SYSTEM_ESTOP])
def test_an_emergency_stop_at_the_robot_trips_everywhere(state: State, mode: SafetyMode) -> None:
    assert code(with_arm(replace(GOOD, state=state), safety=mode)) is FaultCode.EMERGENCY_STOP


@pytest.mark.parametrize("state", POWERED)
def test_an_emergency_stop_at_the_charger_trips_everywhere_and_once_released_all_but_the_self_check(
    state: State,
) -> None:
    seen = replace(GOOD, state=state)
    assert code(with_charger(seen, estop=True)) is FaultCode.EMERGENCY_STOP
    released = with_charger(seen, state=ChargerState.ESTOP)
    assert code(released) is (None if state is State.SELF_CHECK else FaultCode.EMERGENCY_STOP)
    faulty = with_charger(seen, state=ChargerState.FAULT, fault_code=7)
    assert code(faulty) is (None if state is State.SELF_CHECK else FaultCode.CHARGER_FAULT)


@pytest.mark.parametrize("state", POWERED)
def test_a_protective_stop_trips_everywhere(state: State) -> None:
    assert code(with_arm(replace(GOOD, state=state), safety=SafetyMode.PROTECTIVE_STOP)) is FaultCode.PROTECTIVE_STOP


@pytest.mark.parametrize("state", POWERED)
@pytest.mark.parametrize("mode", [SafetyMode.VIOLATION, SafetyMode.FAULT, SafetyMode.RECOVERY])
def test_what_the_robots_safety_system_stopped_is_named_everywhere(state: State, mode: SafetyMode) -> None:
    assert code(with_arm(replace(GOOD, state=state), safety=mode)) is FaultCode.SAFETY_SYSTEM


@pytest.mark.parametrize("state", POWERED)
def test_a_person_in_the_zone_pauses_before_contact_and_trips_from_contact_on(state: State) -> None:
    seen = with_arm(replace(GOOD, state=state), safety=SafetyMode.SAFEGUARD_STOP)
    if state in PAUSABLE_STATES:
        assert assess(seen) is None and pause_reason(seen)
    else:
        assert code(seen) is FaultCode.SAFEGUARD_STOP and pause_reason(seen) is None


def test_a_speed_slider_at_zero_pauses_before_contact_only() -> None:
    paused = {s for s in POWERED if pause_reason(with_arm(replace(GOOD, state=s), speed_scaling=0.0))}
    assert paused == PAUSABLE_STATES


@pytest.mark.parametrize("state", POWERED)
def test_the_chargers_inhibit_trips_only_what_moves(state: State) -> None:
    expected = FaultCode.CHARGER_FAULT if state in MOVING_STATES else None
    assert code(with_charger(replace(GOOD, state=state), motion_inhibit=True)) is expected


def test_a_tick_that_comes_too_late_trips_what_moves() -> None:
    late = replace(GOOD, late_s=0.31, stall_s=0.3)
    assert code(late) is FaultCode.SUPERVISOR_STALLED
    assert assess(replace(late, state=State.CHARGING)) is None
    assert assess(replace(GOOD, late_s=0.3, stall_s=0.3)) is None


@pytest.mark.parametrize("state", POWERED)
def test_an_overdue_state_trips(state: State) -> None:
    assert code(replace(GOOD, state=state, overdue="too long")) is FaultCode.DEADLINE


def test_the_most_urgent_cause_is_named_first() -> None:
    everything = replace(
        with_arm(GOOD, safety=SafetyMode.ROBOT_ESTOP), charger=None, scanner_up=False, overdue="x", late_s=9.0
    )
    assert code(everything) is FaultCode.EMERGENCY_STOP


@pytest.mark.parametrize("state", [State.FAULT, State.OFFLINE])
def test_a_latched_fault_is_not_replaced_by_another(state: State) -> None:
    assert assess(replace(GOOD, state=state, arm=None, charger=None, overdue="x")) is None


@pytest.mark.parametrize("state", POWERED)
def test_a_host_that_was_suspended_is_named_not_the_links_that_it_did_not_read(state: State) -> None:
    silent = replace(GOOD, state=state, arm=None, arm_problem="silent", charger=None, charger_problem="silent")
    assert code(silent) is FaultCode.ARM_LINK_LOST
    assert code(replace(silent, late_s=3.0)) is FaultCode.SUPERVISOR_STALLED
