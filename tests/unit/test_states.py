"""The transition table: exhaustive, and what must hold for every path through it."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.states import IN_CONTACT, LATCHING, TRANSITIONS, Event, State, as_dot, as_markdown, next_state

events = st.lists(st.sampled_from(Event), max_size=60)


def walk(start: State, sequence: list[Event]) -> list[State]:
    passed = [start]
    for event in sequence:
        passed.append(next_state(passed[-1], event))
    return passed


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
