"""What holds for the whole transition table, the gate and the interlocks together: properties, not examples.

Where a property is about a path, every path is looked at (the table is small), not a sample of them.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.commands import Comply, MoveJoints, MoveLinear, MoveVelocity
from controller.config import DeadlinesConfig
from controller.faults import EVENT_OF, REMEDIES, Fault, FaultCode
from controller.insertion import CLEAR_M
from controller.interlocks import MOVING_STATES, PAUSABLE_STATES
from controller.mission import STEPS
from controller.safety import check
from controller.situation import Situation
from controller.states import IN_CONTACT, LATCHING, RESTING, TRANSITIONS, Event, State, next_state
from drivers.base import ChargerRequest, PlugLock, Proximity
from perception.geometry import Pose
from tests.unit.test_safety import CHARGER, LIMITS, PORT, arm_at, compliance, tcp_at

PAIRS = list(itertools.product(State, Event))


# --- the table --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("state", "event"), PAIRS)
def test_every_state_and_event_has_one_answer_and_none_leads_out_of_offline_but_the_start(
    state: State, event: Event
) -> None:
    target = next_state(state, event)
    assert isinstance(target, State) and next_state(state, event) is target
    if state is State.OFFLINE:
        assert (target is State.SELF_CHECK) == (event is Event.STARTED)
    elif event in LATCHING:
        assert target is State.FAULT


def ways(start: State, goal: State, avoid: set[State]) -> bool:
    """Whether any sequence of events leads from start to goal without passing a state of ``avoid``."""
    reached, front = {start}, [start]
    while front:
        state = front.pop()
        for event in Event:
            target = next_state(state, event)
            if target not in reached and target not in avoid:
                reached.add(target)
                front.append(target)
    return goal in reached


@pytest.mark.parametrize("state", sorted(IN_CONTACT - {State.RETREATING}))
def test_no_path_from_contact_to_ready_goes_round_retreating_but_through_fault_and_a_reset(state: State) -> None:
    assert ways(state, State.READY, avoid=set())
    assert not ways(state, State.READY, avoid={State.RETREATING, State.FAULT, State.OFFLINE})
    out_of_fault = {event for event in Event if next_state(State.FAULT, event) is State.SELF_CHECK}
    assert out_of_fault == {Event.RESET}


@pytest.mark.parametrize("state", sorted(IN_CONTACT - {State.RETREATING}))
def test_no_path_from_contact_leads_to_free_motion_without_retreating_or_a_self_check(state: State) -> None:
    for free in (State.STAGING, State.SCANNING, State.APPROACHING, State.HOLD):
        assert not ways(state, free, avoid={State.RETREATING, State.SELF_CHECK})


def test_power_is_only_on_the_way_from_verifying_or_a_charge_that_was_found() -> None:
    into_charging = {state for (state, _), target in TRANSITIONS.items() if target is State.CHARGING}
    assert into_charging == {State.VERIFYING, State.SELF_CHECK}


def test_every_state_that_is_not_rest_has_a_deadline_and_each_deadline_has_a_state() -> None:
    named = {f"{state.name.lower()}_s" for state in State if state not in RESTING}
    assert named == set(DeadlinesConfig.model_fields)
    assert all(value > 0 for value in DeadlinesConfig().model_dump().values())


def test_every_state_has_a_step() -> None:
    rests = {State.OFFLINE, State.READY, State.CHARGING, State.FAULT}
    assert set(STEPS) | rests == set(State) and not set(STEPS) & rests


def test_what_can_move_is_watched_for_stalls_and_nothing_pauses_in_contact() -> None:
    assert not PAUSABLE_STATES & IN_CONTACT
    assert {State.STAGING, State.SCANNING, State.APPROACHING, State.INSERTING, State.RETREATING} <= MOVING_STATES


@pytest.mark.parametrize("code", list(FaultCode))
def test_every_fault_has_a_remedy_in_words_and_latches(code: FaultCode) -> None:
    assert len(REMEDIES[code]) > 20 and REMEDIES[code].endswith(".")
    assert Fault(code).event in LATCHING and EVENT_OF.get(code, Event.FAILED) in LATCHING


# --- the gate over the table ------------------------------------------------------------------------------------------

depths = st.floats(-0.3, 0.04)
offsets = st.sampled_from([0.0, 0.0019, -0.0019, 0.0021, -0.0021, 0.005, 0.3])
"""Dense about the capture radius of 2 mm: a bound is tested at the bound."""
chargers = st.builds(
    lambda prox, lock, closed, amps, fresh: replace(
        CHARGER,
        proximity=prox,
        lock=lock,
        contactor_closed=closed,
        current_a=amps,
        electrical_time_s=0.0 if fresh else -np.inf,
    ),
    st.sampled_from(Proximity),
    st.just(PlugLock.UNLOCKED) | st.sampled_from(PlugLock),
    st.just(False) | st.booleans(),
    st.sampled_from([0.0, 0.9, 1.0, -1.0, 32.0]),
    st.just(True) | st.booleans(),
)


@st.composite
def motions(draw: st.DrawFn):  # type: ignore[no-untyped-def]
    """Any motion that somebody might ask for, within speed and force limits: only the place is in question."""
    target = tcp_at(draw(depths), draw(offsets)).moved([0.0, draw(offsets), 0.0])
    velocity = np.array([draw(st.floats(-0.008, 0.008)) for _ in range(3)] + [0.0, 0.0, 0.0])
    tilt = Pose.from_rotvec([draw(st.floats(-1.5, 1.5)), draw(st.floats(-1.5, 1.5)), 0.0])
    return draw(
        st.sampled_from(
            [
                MoveJoints(target, 0.2, 0.5),
                MoveLinear(target, 0.02, 0.3),
                MoveVelocity(velocity, 0.2),
                compliance(draw(st.floats(-70, 70)), T_base_task=PORT @ tilt),
            ]
        )
    )


def sideways_m(command: object, now: Situation) -> float:
    """How far across the port's axis a motion leads; a velocity for a second, force mode 100 mm along its axis."""
    assert now.arm is not None
    to_port = PORT.inverse()
    match command:
        case MoveLinear(T_base_tcp=target) | MoveJoints(T_base_tcp=target):
            here = to_port.apply(now.arm.T_base_tcp.translation)
            return float(np.linalg.norm((to_port.apply(target.translation) - here)[:2]))
        case MoveVelocity(velocity=velocity):
            return float(np.linalg.norm(to_port.rotate(velocity[:3])[:2]))
        case Comply(compliance=c):
            return float(np.linalg.norm(to_port.rotate(c.T_base_task.rotation[:, 2])[:2])) * 0.1
    raise AssertionError(command)


@given(st.sampled_from(sorted(MOVING_STATES)), motions(), depths, chargers)
def test_no_motion_while_inserted_leads_beyond_the_capture_radius(state, motion, depth, charger) -> None:  # type: ignore[no-untyped-def]
    now = Situation(state, arm_at(tcp_at(depth)), charger, PORT, mated=True)
    inserted = charger.proximity is not Proximity.ABSENT or (state in IN_CONTACT and depth > 1e-6)
    if check(motion, now, LIMITS) is None and inserted:
        assert not isinstance(motion, MoveJoints)
        assert sideways_m(motion, now) <= LIMITS.capture_radius_m + 1e-12


@given(motions(), depths, chargers)
def test_no_inserted_plug_is_pulled_while_locked_or_live(motion, depth, charger) -> None:  # type: ignore[no-untyped-def]
    now = Situation(State.RETREATING, arm_at(tcp_at(depth)), charger, PORT, mated=True)
    if check(motion, now, LIMITS) is None and (depth > 1e-6 or charger.proximity is not Proximity.ABSENT):
        assert charger.lock is PlugLock.UNLOCKED
        assert not charger.contactor_closed and abs(charger.current_a) < 1.0
        assert np.isfinite(charger.electrical_time_s)


@given(motions(), depths, chargers, st.booleans())
def test_after_a_latched_fault_nothing_that_moves_or_makes_live_passes(motion, depth, charger, mated) -> None:  # type: ignore[no-untyped-def]
    from controller.commands import AskCharger, Laser, ZeroForce

    now = Situation(State.FAULT, arm_at(tcp_at(depth)), charger, PORT, mated=mated)
    assert check(motion, now, LIMITS) is not None
    for command in (Laser(on=True), ZeroForce()):
        assert check(command, now, LIMITS) is not None
    harmless = {ChargerRequest.NONE, ChargerRequest.STOP_POWER, ChargerRequest.ABORT}
    for request in set(ChargerRequest) - harmless:
        assert check(AskCharger(request), now, LIMITS) is not None


@given(motions(), depths, chargers)
def test_a_charging_controller_moves_nothing(motion, depth, charger) -> None:  # type: ignore[no-untyped-def]
    for state in (State.CHARGING, State.RELEASING, State.OFFLINE, State.READY, State.SELF_CHECK, State.HOLD):
        assert check(motion, Situation(state, arm_at(tcp_at(depth)), charger, PORT, True), LIMITS) is not None


def test_a_plug_counts_as_out_only_in_front_of_the_rim_plane() -> None:
    assert CLEAR_M > 0.0


@pytest.mark.parametrize("depth", [0.001, 0.02, 0.035])
@pytest.mark.parametrize(("aside_mm", "allowed"), [(0.0, True), (1.99, True), (2.01, False), (20.0, False)])
def test_the_capture_radius_is_the_bound(depth: float, aside_mm: float, allowed: bool) -> None:
    aside = aside_mm / 1000.0
    pulled = Situation(State.RETREATING, arm_at(tcp_at(depth)), CHARGER, PORT)
    pushed = replace(pulled, state=State.INSERTING)
    assert (check(MoveLinear(tcp_at(-0.05, aside), 0.02, 0.3), pulled, LIMITS) is None) == allowed
    if aside < LIMITS.insertion_speed_m_s:
        assert (check(MoveVelocity(np.array([aside, 0, 0, 0, 0, 0.0]), 0.2), pushed, LIMITS) is None) == allowed
