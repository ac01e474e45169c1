"""The contact model: forces in each situation, and outcomes that follow from the misalignment alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mocks.world import contact
from perception.geometry import Pose

FACING = np.diag([1.0, -1.0, -1.0])
MATED = Pose(FACING, np.array([0.0, 0.0, -0.049]))
PORT = contact.Port(MATED)


def _plug(depth_m: float, lateral=(0.0, 0.0), rotvec=(0.0, 0.0, 0.0)) -> contact.Misalignment:
    return contact.Misalignment(depth_m, np.array(lateral), np.array(rotvec))


def _push_in(plug: contact.Misalignment, port: contact.Port, to_m: float = 0.049, locked: bool = False):
    """Advance along the axis in steps of 0.1 mm; all states, wrenches and reports."""
    state, trace = contact.ContactState(), []
    for depth in np.arange(-0.002, to_m + 1e-9, 0.0001):
        here = contact.Misalignment(float(depth), plug.lateral, plug.rotvec)
        state, wrench, told = contact.step(state, here, port, locked)
        trace.append((state, wrench, told))
    return trace


def _insert_with_compliance(plug: contact.Misalignment, port: contact.Port, push_n: float = 60.0):
    """What an arm that yields in all axes does; returns the last report and the largest axial force."""
    state, pose, peak, still = contact.ContactState(), plug, 0.0, 0
    while still < 60:
        state, wrench, told = contact.step(state, pose, port, False)
        peak = max(peak, float(wrench[2]))
        along = float(np.clip(0.001 * (push_n - wrench[2]), -0.015, 0.015)) * 0.008
        lateral = pose.lateral + np.clip(0.001 * wrench[:2], -0.01, 0.01) * 0.008
        rotvec = pose.rotvec + np.clip(0.02 * wrench[3:], -0.05, 0.05) * 0.008
        turned = float(np.abs(rotvec - pose.rotvec).max())
        still = still + 1 if abs(along) < 2e-7 and turned < 1e-6 else 0
        pose = contact.Misalignment(pose.depth_m + along, lateral, rotvec)
    return told, peak


def test_misalignment_is_zero_where_the_plug_is_home() -> None:
    plug = contact.misalignment(MATED.matrix, PORT)
    assert (plug.depth_m, plug.lateral_m, plug.tilt_rad, plug.roll_rad) == pytest.approx((0.049, 0.0, 0.0, 0.0))


def test_misalignment_is_told_in_port_axes() -> None:
    T_port_tcp = Pose(FACING, np.array([0.001, -0.002, 0.02])) @ Pose.from_rotvec([0.0, 0.0, -0.03])
    plug = contact.misalignment(T_port_tcp.matrix, PORT)
    assert plug.depth_m == pytest.approx(-0.02)
    assert plug.lateral == pytest.approx([0.001, -0.002])
    assert plug.rotvec == pytest.approx([0.0, 0.0, 0.03])  # the tool looks along -z of the port


def test_nothing_is_felt_in_front_of_the_rim() -> None:
    _, wrench, told = contact.step(contact.ContactState(), _plug(-0.0001, (0.001, 0.0)), PORT, False)
    assert not wrench.any() and not told.seated


def test_outside_capture_the_plug_lands_on_the_face_and_the_force_only_rises() -> None:
    trace = _push_in(_plug(0.0, (0.003, 0.0)), PORT, to_m=0.004)
    axial = [wrench[2] for _, wrench, _ in trace if wrench[2] > 0.0]
    assert np.diff(axial).min() > 0.0 and axial[-1] == pytest.approx(20e3 * 0.004)
    assert not any(state.captured for state, _, _ in trace)


def test_the_face_holds_a_plug_against_a_small_pull_but_not_against_a_search() -> None:
    state, wrench, _ = contact.step(contact.ContactState(), _plug(0.003, (0.004, 0.0)), PORT, False)
    state, wrench, _ = contact.step(state, _plug(0.003, (0.0039, 0.0)), PORT, False)
    assert wrench[0] == pytest.approx(10e3 * 0.0001)
    for x in np.arange(0.0039, 0.003, -0.0001):
        state, wrench, _ = contact.step(state, _plug(0.003, (float(x), 0.0)), PORT, False)
    assert wrench[0] == pytest.approx(0.1 * wrench[2])


def test_a_plug_moved_across_the_face_into_capture_falls_in() -> None:
    state, wrench, _ = contact.step(contact.ContactState(), _plug(0.001, (0.004, 0.0)), PORT, False)
    assert not state.captured and wrench[2] > 10.0
    state, wrench, _ = contact.step(state, _plug(0.001, (0.001, 0.0)), PORT, False)
    assert state.captured and wrench[2] < 10.0


def test_axial_friction_rises_to_the_click_then_lets_go_then_the_stop_is_hard() -> None:
    trace = _push_in(_plug(0.0), PORT, to_m=0.0505)
    axial = np.array([wrench[2] for _, wrench, _ in trace])
    depth = np.array([told.depth_m for _, _, told in trace])
    peak = int(np.argmax(axial[depth < 0.0485]))
    assert depth[peak] == pytest.approx(0.047, abs=0.0003) and axial[peak] == pytest.approx(40.0, abs=1.0)
    home = axial[np.abs(depth - 0.049) < 1e-6][0]
    assert home < 15.0
    assert axial[-1] == pytest.approx(home + 60e3 * 0.0015, rel=0.05)


def test_only_a_plug_within_half_a_millimetre_of_home_is_seated() -> None:
    told = [told for _, _, told in _push_in(_plug(0.0), PORT)]
    assert not any(t.seated for t in told if t.depth_m < 0.0485 - 1e-6)
    assert all(t.seated for t in told if t.depth_m > 0.0485 + 1e-6)


def test_friction_turns_round_on_the_way_out() -> None:
    state = _push_in(_plug(0.0), PORT, to_m=0.03)[-1][0]
    for depth in np.arange(0.03, 0.025, -0.0001):
        state, wrench, _ = contact.step(state, _plug(float(depth)), PORT, False)
    assert wrench[2] == pytest.approx(-0.8 * contact.axial_friction_n(0.0251, PORT), rel=0.02)


def test_a_locked_latch_holds_a_plug_that_is_home_and_no_other() -> None:
    home = _push_in(_plug(0.0), PORT)[-1][0]
    home, _, _ = contact.step(home, _plug(0.049), PORT, True)
    _, pulled, _ = contact.step(home, _plug(0.046), PORT, True)
    assert pulled[2] < -150.0
    half = _push_in(_plug(0.0), PORT, to_m=0.02, locked=True)[-1][0]
    _, loose, _ = contact.step(half, _plug(0.018), PORT, True)
    assert loose[2] > -40.0


def test_an_unlocked_latch_lets_go() -> None:
    home = _push_in(_plug(0.0), PORT)[-1][0]
    home, _, _ = contact.step(home, _plug(0.049), PORT, True)
    _, pulled, _ = contact.step(home, _plug(0.046), PORT, False)
    assert pulled[2] > -45.0


def test_across_and_about_the_axis_springs_lead_back_to_the_middle() -> None:
    *_, (_, wrench, _) = _push_in(_plug(0.0, (0.001, -0.0005), (0.02, 0.0, -0.03)), PORT, to_m=0.02)
    assert wrench[0] < 0.0 < wrench[1]
    assert wrench[3] < 0.0 < wrench[5] and wrench[4] == 0.0


def test_something_in_the_port_stops_the_plug_there() -> None:
    port = contact.Port(MATED, blocked_depth_m=0.02)
    told, peak = _insert_with_compliance(_plug(-0.001), port)
    assert told.depth_m == pytest.approx(0.021, abs=0.001) and not told.seated
    assert peak == pytest.approx(60.0, abs=3.0)


def test_a_plain_panel_has_nothing_to_enter() -> None:
    told, _ = _insert_with_compliance(_plug(-0.001), contact.Port(MATED, exists=False))
    assert told.depth_m < 0.006


@pytest.mark.parametrize(
    ("lateral_mm", "tilt_deg", "roll_deg", "outcome"),
    [
        (0.0, 0.0, 0.0, "mates"),
        (2.4, 2.4, 2.9, "mates"),
        (2.6, 0.0, 0.0, "blocked"),
        (0.0, 2.6, 0.0, "blocked"),
        (0.0, 0.0, 3.1, "blocked"),
        (0.0, 0.0, -3.1, "blocked"),
    ],
)
def test_each_kind_of_misalignment_has_its_own_limit(
    lateral_mm: float, tilt_deg: float, roll_deg: float, outcome: contact.Outcome
) -> None:
    start = _plug(-0.001, (0.0, lateral_mm / 1000), (0.0, math.radians(tilt_deg), math.radians(roll_deg)))
    told, _ = _insert_with_compliance(start, PORT)
    assert told.seated == (outcome == "mates")
    assert contact.predict_outcome(start, PORT) == outcome


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.0, 0.005), st.floats(0.0, 2 * math.pi), st.floats(-0.08, 0.08), st.floats(-0.08, 0.08),
    st.floats(-0.08, 0.08), st.sampled_from([None, 0.015, 0.03]),
)  # fmt: skip
def test_the_outcome_of_a_compliant_push_is_the_predicted_one(
    lateral_m: float, angle: float, rx: float, ry: float, roll: float, blocked: float | None
) -> None:
    p = PORT.parameters
    start = _plug(-0.001, (lateral_m * math.cos(angle), lateral_m * math.sin(angle)), (rx, ry, roll))
    for value, limit in ((lateral_m, p.capture_radius_m), (start.tilt_rad, p.capture_tilt_rad)):
        assume(abs(value - limit) > 1e-6)
    port = contact.Port(MATED, blocked_depth_m=blocked)
    told, peak = _insert_with_compliance(start, port)
    assert told.seated == (contact.predict_outcome(start, port) == "mates")
    assert peak < 66.0
