"""The campaign's rules are complete before anything runs, and its judgement names every way in which one is broken."""

from __future__ import annotations

from dataclasses import replace

import pytest

from controller.campaign.findings import Findings, violations
from controller.campaign.inject import MAKE
from controller.campaign.rules import FAULTS, STATES, Arm, rule
from controller.campaign.table import as_html, as_markdown, verdict
from controller.states import State

GOOD = Findings(
    fault="emergency-stop",
    state="INSERTING",
    made=True,
    outcome="fault",
    code="emergency-stop",
    detail="",
    drift_m=0.0001,
    live_travel_m=0.0,
    clear=False,
    recorded_until_s=0.1,
    next_start="ready",
    next_travel_m=0.0,
    duration_s=20.0,
)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("state", list(State))
def test_every_cell_has_a_rule_or_says_why_it_is_impossible(fault: str, state: State) -> None:
    wanted = rule(fault, state)
    assert wanted.impossible or wanted.kinds
    assert bool(wanted.impossible) or "fault" not in wanted.kinds or wanted.codes, "a fault must name its cause"
    assert state in STATES or wanted.impossible


def test_every_fault_of_the_catalogue_can_be_made_or_is_impossible_everywhere() -> None:
    nowhere = {fault for fault in FAULTS if all(rule(fault, state).impossible for state in STATES)}
    assert set(MAKE) == set(FAULTS) - nowhere
    assert nowhere == {"arm-corrupted"}


def test_each_link_is_cut_frozen_late_and_corrupted_where_that_can_be() -> None:
    for link in ("arm", "charger", "scanner"):
        assert {f"{link}-{way}" for way in ("cut", "frozen", "late", "corrupted")} <= set(FAULTS)


def test_a_killed_process_leaves_the_arm_standing_and_a_recording_to_the_last_second() -> None:
    killed = replace(GOOD, fault="process-killed", outcome="killed", code=None, next_start="fault: plug-inserted")
    for state in STATES:
        assert violations(killed, rule("process-killed", state)) == ()
    assert violations(replace(killed, drift_m=0.01), rule("process-killed", State.STAGING))


def test_what_breaks_contact_by_force_of_a_fault_stands_still() -> None:
    """From insertion on only a stop, which finishes safely, moves the arm."""
    for state in (State.INSERTING, State.VERIFYING, State.CHARGING, State.RELEASING):
        for fault in ("emergency-stop", "arm-frozen", "charger-frozen", "abort"):
            assert rule(fault, state).arm is Arm.STANDS
        assert rule("stop", state).arm is Arm.RETREATS


def test_a_run_that_keeps_its_rule_breaks_nothing() -> None:
    assert violations(GOOD, rule("emergency-stop", State.INSERTING)) == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"made": False}, "not made"),
        ({"outcome": "charged", "code": None}, "outcome charged"),
        ({"code": "deadline"}, "does not name the cause"),
        ({"drift_m": 0.003}, "should have stood"),
        ({"live_travel_m": 0.003}, "under power"),
        ({"recorded_until_s": 1.5}, "lacks its last"),
        ({"next_travel_m": 0.01}, "self-check"),
        ({"next_start": ""}, "did not come up"),
    ],
)
def test_each_way_to_break_a_rule_is_named(change: dict[str, object], said: str) -> None:
    broken = violations(replace(GOOD, **change), rule("emergency-stop", State.INSERTING))  # type: ignore[arg-type]
    assert len(broken) == 1
    assert said in broken[0]


def test_a_stop_that_leaves_the_plug_in_is_broken() -> None:
    stopped = replace(GOOD, fault="stop", outcome="stopped", code=None, clear=False)
    assert violations(stopped, rule("stop", State.INSERTING)) == ("the arm did not end clear of the vehicle",)


def test_a_full_disk_may_cost_the_end_of_the_recording_but_not_the_mission() -> None:
    full = replace(GOOD, outcome="charged", code=None, recorded_until_s=20.0)
    assert violations(full, rule("disk-full", State.CHARGING)) == ()


def test_the_tables_tell_good_broken_impossible_and_missing_apart() -> None:
    results = {("emergency-stop", "INSERTING"): GOOD, ("abort", "INSERTING"): replace(GOOD, fault="abort")}
    assert verdict("emergency-stop", State.INSERTING, results)[0] == "ok"
    assert verdict("abort", State.INSERTING, results)[0] == "BROKEN"
    assert verdict("perception-refuses", State.INSERTING, results)[0] == "impossible"
    assert verdict("stop", State.INSERTING, results)[0] == "not run"
    faults = ["emergency-stop", "abort", "perception-refuses", "stop"]
    text = as_markdown(faults, [State.INSERTING], results)
    assert "1 ok, 1 BROKEN, 1 impossible, 1 not run" in text
    assert 'class="broken"' in as_html(faults, [State.INSERTING], results)
