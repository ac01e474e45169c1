"""The transition table: exhaustive, and what must hold for every path through it."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.config import load_config
from controller.states import (
    IN_CONTACT,
    LATCHING,
    RESTING,
    TRANSITIONS,
    Event,
    State,
    as_dot,
    as_markdown,
    next_state,
)

events = st.lists(st.sampled_from(Event), max_size=60)


def walk(start: State, sequence: list[Event]) -> list[State]:
    passed = [start]
    for event in sequence:
        passed.append(next_state(passed[-1], event))
    return passed


def test_numbers_and_words_are_those_that_heartbeats_and_recordings_carry() -> None:
    """A number on the bus means the same to every charger that is out there, a word the same in every old recording."""
    assert {state.name: int(state) for state in State} == {
        "OFFLINE": 0,
        "SELF_CHECK": 1,
        "READY": 2,
        "STAGING": 3,
        "SCANNING": 4,
        "LOCATING": 5,
        "APPROACHING": 6,
        "INSERTING": 7,
        "VERIFYING": 8,
        "CHARGING": 9,
        "RELEASING": 10,
        "RETREATING": 11,
        "HOLD": 12,
        "FAULT": 15,
    }
    assert {event.name: event.value for event in Event} == {
        "STARTED": "started",
        "CHECKS_PASSED": "checks passed",
        "CHARGING_FOUND": "charging found at start",
        "DOCK_REQUESTED": "dock requested",
        "UNDOCK_REQUESTED": "undock requested",
        "AT_STAGING": "at staging",
        "SCAN_COMPLETE": "scan complete",
        "LOCATED": "located",
        "NEXT_VIEWPOINT": "not located, next viewpoint",
        "NOT_LOCATED": "not located, viewpoints used up",
        "AT_PRE_CONTACT": "at pre-contact",
        "SEATED": "seated",
        "NOT_INSERTED": "not inserted",
        "MATED": "mated",
        "NOT_MATED": "not mated",
        "CHARGE_COMPLETE": "charge complete",
        "RELEASED": "released",
        "RETREATED": "retreated",
        "RETREATED_TO_RETRY": "retreated, next attempt",
        "PAUSED": "paused",
        "RESUMED": "resumed",
        "RESET": "operator's reset",
        "SHUT_DOWN": "shut down",
        "STOP": "stop requested",
        "ABORT": "abort requested",
        "ESTOP": "emergency stop",
        "PROTECTIVE_STOP": "protective stop",
        "LINK_LOST": "link lost",
        "CHARGER_FAULT": "charger fault",
        "DEADLINE": "deadline passed",
        "FAILED": "check failed",
    }


@given(st.sampled_from(State), st.sampled_from(Event))
def test_every_pair_of_state_and_event_is_decided(state: State, event: Event) -> None:
    assert isinstance(next_state(state, event), State)


@pytest.mark.parametrize("state", [s for s in State if s is not State.OFFLINE])
@pytest.mark.parametrize("event", sorted(LATCHING, key=lambda e: e.value))
def test_latching_events_lead_to_fault_from_every_powered_state(state: State, event: Event) -> None:
    assert next_state(state, event) is State.FAULT


def test_only_an_operators_reset_or_the_end_leads_out_of_fault() -> None:
    ways_out = {event for event in Event if next_state(State.FAULT, event) is not State.FAULT}
    assert ways_out == {Event.RESET, Event.SHUT_DOWN}


@given(events)
def test_from_contact_back_to_ready_only_through_retreating_or_fault(sequence: list[Event]) -> None:
    passed = walk(State.INSERTING, sequence)
    if State.READY in passed:
        before = passed[: passed.index(State.READY)]
        assert State.RETREATING in before or State.FAULT in before


@given(events)
def test_fault_is_followed_by_the_self_check_or_nothing(sequence: list[Event]) -> None:
    passed = walk(State.OFFLINE, sequence)
    after_fault = {b for a, b in itertools.pairwise(passed) if a is State.FAULT}
    assert after_fault <= {State.FAULT, State.SELF_CHECK, State.OFFLINE}


@pytest.mark.parametrize("state", sorted(IN_CONTACT))
def test_no_pause_exists_from_contact_on(state: State) -> None:
    assert next_state(state, Event.PAUSED) is state


@pytest.mark.parametrize("state", sorted(IN_CONTACT - {State.RETREATING, State.RELEASING}))
def test_a_stop_in_contact_goes_out_the_safe_way(state: State) -> None:
    assert next_state(state, Event.STOP) in (State.RETREATING, State.RELEASING)


def test_a_stop_with_power_on_releases_before_it_retreats() -> None:
    assert next_state(State.CHARGING, Event.STOP) is State.RELEASING
    assert next_state(State.VERIFYING, Event.STOP) is State.RELEASING


def test_every_state_but_offline_can_be_reached_from_offline() -> None:
    reached, front = {State.OFFLINE}, {State.OFFLINE}
    while front:
        front = {next_state(s, e) for s in front for e in Event} - reached
        reached |= front
    assert reached == set(State)


def test_the_procedure_runs_through_every_state_of_a_successful_cycle() -> None:
    cycle = [
        Event.STARTED, Event.CHECKS_PASSED, Event.DOCK_REQUESTED, Event.AT_STAGING, Event.SCAN_COMPLETE, Event.LOCATED,
        Event.AT_PRE_CONTACT, Event.SEATED, Event.MATED, Event.CHARGE_COMPLETE, Event.RELEASED, Event.RETREATED,
    ]  # fmt: skip
    names = [state.name for state in walk(State.OFFLINE, cycle)]
    assert names == [
        "OFFLINE", "SELF_CHECK", "READY", "STAGING", "SCANNING", "LOCATING", "APPROACHING", "INSERTING", "VERIFYING",
        "CHARGING", "RELEASING", "RETREATING", "READY",
    ]  # fmt: skip


def test_the_printed_table_names_every_transition_that_does_not_latch() -> None:
    table = as_markdown()
    for (state, event), target in TRANSITIONS.items():
        if event not in LATCHING:
            assert f"| {state.name} | {event.value} | {target.name} |" in table
    assert as_dot().startswith("digraph") and "INSERTING -> VERIFYING" in as_dot()


DECIDED = """
OFFLINE STARTED SELF_CHECK
SELF_CHECK CHECKS_PASSED READY
SELF_CHECK CHARGING_FOUND CHARGING
SELF_CHECK UNDOCK_REQUESTED RELEASING
READY DOCK_REQUESTED STAGING
READY UNDOCK_REQUESTED RETREATING
STAGING AT_STAGING SCANNING
SCANNING SCAN_COMPLETE LOCATING
LOCATING LOCATED APPROACHING
LOCATING NEXT_VIEWPOINT STAGING
LOCATING NOT_LOCATED READY
APPROACHING AT_PRE_CONTACT INSERTING
INSERTING SEATED VERIFYING
INSERTING NOT_INSERTED RETREATING
VERIFYING MATED CHARGING
VERIFYING NOT_MATED RETREATING
CHARGING CHARGE_COMPLETE RELEASING
CHARGING UNDOCK_REQUESTED RELEASING
RELEASING RELEASED RETREATING
RETREATING RETREATED READY
RETREATING RETREATED_TO_RETRY STAGING
HOLD RESUMED STAGING
FAULT RESET SELF_CHECK
STAGING PAUSED HOLD
SCANNING PAUSED HOLD
LOCATING PAUSED HOLD
APPROACHING PAUSED HOLD
STAGING STOP READY
SCANNING STOP READY
LOCATING STOP READY
HOLD STOP READY
APPROACHING STOP RETREATING
INSERTING STOP RETREATING
VERIFYING STOP RELEASING
CHARGING STOP RELEASING
SELF_CHECK SHUT_DOWN OFFLINE
READY SHUT_DOWN OFFLINE
CHARGING SHUT_DOWN OFFLINE
FAULT SHUT_DOWN OFFLINE
"""
"""The whole table but for the latching events, written out once more: no cell changes unnoticed."""


def test_every_cell_of_the_table_is_as_written_here() -> None:
    wanted = {(a, e): b for a, e, b in (line.split() for line in DECIDED.split("\n") if line)}
    for state, event in itertools.product(State, Event):
        if state is not State.OFFLINE and event in LATCHING:
            assert next_state(state, event) is State.FAULT
        else:
            target = wanted.get((state.name, event.name), state.name)
            assert next_state(state, event).name == target, (state, event)


def test_the_numbers_on_the_bus_are_these() -> None:
    assert {state.name: int(state) for state in State} == {
        "OFFLINE": 0, "SELF_CHECK": 1, "READY": 2, "STAGING": 3, "SCANNING": 4, "LOCATING": 5, "APPROACHING": 6,
        "INSERTING": 7, "VERIFYING": 8, "CHARGING": 9, "RELEASING": 10, "RETREATING": 11, "HOLD": 12, "FAULT": 15,
    }  # fmt: skip


@pytest.mark.parametrize("state", [s for s in State if s not in RESTING])
def test_no_state_in_which_something_is_under_way_is_without_a_deadline(state: State) -> None:
    deadline_s = getattr(load_config().deadlines, f"{state.name.lower()}_s")
    assert 0.0 < deadline_s < float("inf")


@given(st.lists(st.sampled_from(Event), max_size=60), st.sampled_from(sorted(IN_CONTACT)))
def test_a_new_attempt_after_contact_comes_through_retreating_or_a_reset(sequence: list[Event], start: State) -> None:
    passed = walk(start, sequence)
    for name in (State.STAGING, State.READY):
        if name in passed:
            before = passed[: passed.index(name)]
            assert State.RETREATING in before or {State.FAULT, State.SELF_CHECK} <= set(before)


def test_the_drawing_has_every_edge_and_nothing_else() -> None:
    drawn = [line for line in as_dot().splitlines() if "->" in line and "ANY" not in line]
    edges = {(a, b) for (a, e), b in TRANSITIONS.items() if e not in LATCHING}
    assert len(drawn) == len(edges)
    for source, target in edges:
        events = [e.value for (a, e), b in TRANSITIONS.items() if (a, b) == (source, target) and e not in LATCHING]
        label = r"\n".join(events)
        assert f'  {source.name} -> {target.name} [label="{label}"];' in drawn
    assert as_dot().splitlines()[:2] == ["digraph portdock {", "  rankdir=LR; node [shape=box, style=rounded];"]
    assert as_dot().splitlines()[-3:] == [
        '  ANY [label="any state", shape=plaintext];',
        '  ANY -> FAULT [label="latching events"];',
        "}",
    ]


def test_the_printed_table_has_a_head_and_says_what_latches() -> None:
    lines = as_markdown().splitlines()
    assert lines[:2] == ["| state | event | next |", "|---|---|---|"]
    assert lines[-2] == ""
    assert lines[-1] == (
        "In every state but OFFLINE: abort requested, emergency stop, protective stop, link lost, charger fault, "
        "deadline passed, check failed -> FAULT, latched until an operator's reset."
    )


def test_the_plug_may_be_in_the_port_in_five_states_and_the_robot_rests_in_three() -> None:
    assert {state.name for state in IN_CONTACT} == {"INSERTING", "VERIFYING", "CHARGING", "RELEASING", "RETREATING"}
    assert {state.name for state in RESTING} == {"OFFLINE", "READY", "FAULT"}
