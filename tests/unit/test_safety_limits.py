"""The gate's limits, each just inside and just outside, and what is not a number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.commands import AskCharger, BackOff, Command, MoveJoints, MoveLinear, MoveVelocity, ZeroForce
from controller.planning import FACING
from controller.situation import CONTACT_DEPTH_M, LIVE_CURRENT_A, STILL_M_S, Situation
from controller.states import State
from drivers.base import ChargerRequest, PlugLock, Proximity
from perception.geometry import Pose
from tests.unit.test_safety import CHARGER, LIMITS, MOTIONS, arm_at, compliance, rule, said, situation, tcp_at

ORIGIN = Pose.identity()
"""A port at the base, facing up: what is computed from it has no rounding."""
NAN_POSE = Pose(np.eye(3), np.full(3, np.nan))


def before_origin(depth_m: float, x_m: float = 0.0, y_m: float = 0.0) -> Pose:
    return Pose(FACING, np.array([x_m, y_m, -depth_m]))


def at_origin(state: State, pose: Pose, **charger: object) -> Situation:
    return Situation(state, arm_at(pose), replace(CHARGER, **charger), ORIGIN)  # type: ignore[arg-type]


def moving(*velocity: float) -> MoveVelocity:
    return MoveVelocity(np.array(velocity), 0.2)


def axis(index: int, value: float, others: float = 0.0) -> tuple[float, ...]:
    return tuple(value if k == index else others for k in range(6))


def above(value: float) -> float:
    return float(np.nextafter(value, np.inf))


INSERTING = situation(State.INSERTING)
IN_PORT = at_origin(State.RETREATING, before_origin(0.02), proximity=Proximity.INSERTED)


# --- speeds and forces ----------------------------------------------------------------------------------------------


def test_the_documented_constants_are_these() -> None:
    assert (CONTACT_DEPTH_M, STILL_M_S, LIVE_CURRENT_A) == (0.0, 0.002, 1.0)


def test_a_motion_without_speed_is_refused() -> None:
    assert rule(MoveJoints(tcp_at(-0.1), 0.0, 1.0), situation(State.STAGING)) == "speed"
    assert rule(MoveJoints(tcp_at(-0.1), 1e-9, 1.0), situation(State.STAGING)) is None
    assert rule(MoveLinear(tcp_at(-0.1), 0.0, 0.3), situation(State.STAGING)) == "speed"


@pytest.mark.parametrize("index", range(6))
def test_a_velocity_may_be_a_thousandth_over_the_limit_for_rounding_and_no_more(index: int) -> None:
    most = (LIMITS.insertion_speed_m_s if index < 3 else LIMITS.insertion_turn_rad_s) * 1.001
    for sign in (-1.0, 1.0):
        assert rule(moving(*axis(index, sign * most)), INSERTING) is None
        assert rule(moving(*axis(index, sign * above(most))), INSERTING) == "speed"


@pytest.mark.parametrize("index", range(6))
def test_a_compliant_axis_may_be_a_thousandth_over_the_limit_and_no_more(index: int) -> None:
    most = (LIMITS.insertion_speed_m_s if index < 3 else LIMITS.insertion_turn_rad_s) * 1.001
    assert rule(compliance(limits=axis(index, most, 0.001)), INSERTING) is None
    assert rule(compliance(limits=axis(index, above(most), 0.001)), INSERTING) == "speed"


@pytest.mark.parametrize("index", range(6))
def test_a_force_or_moment_on_each_axis_is_capped_at_its_limit(index: int) -> None:
    most = (LIMITS.lateral_force_n, LIMITS.lateral_force_n, LIMITS.axial_force_n, *[LIMITS.moment_nm] * 3)[index]
    for sign in (-1.0, 1.0):
        assert rule(compliance(wrench=axis(index, sign * most)), INSERTING) is None
        assert rule(compliance(wrench=axis(index, sign * above(most))), INSERTING) == "force"


@pytest.mark.parametrize(
    ("command", "now", "text"),
    [
        (moving(0, 0, -1, 2, 0, 0), INSERTING, "speed: 1000.0 mm/s"),
        (moving(0, 0, 0, 1, 0, 0), INSERTING, "speed: 57.3 deg/s"),
        (compliance(wrench=(0, 0, -81.26, 0, 0, 0)), INSERTING, "force: [0.0, 0.0, -81.3] N is over the cap"),
        (BackOff(tcp_at(-0.09, x_m=0.1), 0.05, 0.3), situation(State.APPROACHING), "axis: 100.0 mm sideways"),
        (
            MoveLinear(before_origin(-0.09, x_m=0.1), 0.02, 0.3),
            IN_PORT,
            "inserted: 100.0 mm sideways while the plug is in the port",
        ),
    ],
)
def test_what_is_refused_is_named_with_its_number(command: Command, now: Situation, text: str) -> None:
    assert said(command, now) == text


# --- the force sensor -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "rule_name"),
    [
        ((0.0, 0.0, STILL_M_S, 0.0, 0.0, 0.0), None),
        ((0.0, 0.0, above(STILL_M_S), 0.0, 0.0, 0.0), "zero-force"),
        ((np.nan,) * 6, "zero-force"),
        ((0.0, 0.0, 0.0, 0.003, 0.003, 0.003), None),  # rad/s: what a standing arm reports
    ],
)
def test_at_rest_is_a_tcp_of_two_millimetres_a_second_or_less(speed: tuple[float, ...], rule_name: str | None) -> None:
    resting = replace(situation(State.SELF_CHECK), arm=arm_at(tcp_at(-0.1), tcp_speed=np.array(speed)))
    assert rule(ZeroForce(), resting) == rule_name


@pytest.mark.parametrize(
    ("pose", "rule_name"),
    [(before_origin(0.0), None), (before_origin(1e-9), "zero-force"), (NAN_POSE, "zero-force")],
)
def test_out_of_contact_is_up_to_the_rim_plane(pose: Pose, rule_name: str | None) -> None:
    assert rule(ZeroForce(), at_origin(State.INSERTING, pose)) == rule_name


def test_without_a_port_the_proximity_contact_alone_says_that_the_plug_is_out() -> None:
    assert rule(ZeroForce(), replace(situation(State.SELF_CHECK), T_base_port=None)) is None


# --- the charger ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("current_a", [0.0, 0.999, -0.999])
def test_a_plug_that_is_dead_is_unlocked_and_pulled(current_a: float) -> None:
    dead = situation(State.RELEASING, 0.03, proximity=Proximity.INSERTED, lock=PlugLock.UNLOCKED, current_a=current_a)
    assert rule(AskCharger(ChargerRequest.UNLOCK_PLUG), dead) is None
    assert rule(MoveLinear(tcp_at(-0.09), 0.02, 0.3), replace(dead, state=State.RETREATING)) is None


@pytest.mark.parametrize("current_a", [LIVE_CURRENT_A, -LIVE_CURRENT_A, np.nan, np.inf])
def test_a_plug_with_an_ampere_or_an_unknown_current_is_neither(current_a: float) -> None:
    live = situation(State.RELEASING, 0.03, proximity=Proximity.INSERTED, lock=PlugLock.UNLOCKED, current_a=current_a)
    assert rule(AskCharger(ChargerRequest.UNLOCK_PLUG), live) == "unlock"
    assert rule(MoveLinear(tcp_at(-0.09), 0.02, 0.3), replace(live, state=State.RETREATING)) == "live"


REQUESTED_IN = {
    ChargerRequest.RESERVE: {State.STAGING, State.APPROACHING},
    ChargerRequest.UNLOCK_DOCK: {State.STAGING, State.APPROACHING},
    ChargerRequest.LOCK_PLUG: {State.VERIFYING},
    ChargerRequest.ENABLE_POWER: {State.CHARGING},
    ChargerRequest.UNLOCK_PLUG: {State.VERIFYING, State.RELEASING},
    ChargerRequest.RELEASE: {State.READY, State.RETREATING, State.STAGING, State.RELEASING},
    ChargerRequest.RESET_FAULT: {State.SELF_CHECK},
    ChargerRequest.NONE: set(State),
    ChargerRequest.STOP_POWER: set(State),
    ChargerRequest.ABORT: set(State),
}


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("request_", list(ChargerRequest))
def test_each_request_is_made_in_its_own_states_and_in_no_other(request_: ChargerRequest, state: State) -> None:
    in_and_locked = replace(situation(state, proximity=Proximity.LATCHED, lock=PlugLock.LOCKED), mated=True)
    allowed = rule(AskCharger(request_), in_and_locked) is None
    assert allowed is (state in REQUESTED_IN[request_])


MOVED_IN = {
    State.STAGING: {"MoveJoints", "MoveLinear"},
    State.SCANNING: {"MoveLinear"},
    State.APPROACHING: {"MoveJoints", "MoveLinear"},
    State.INSERTING: {"MoveVelocity", "Comply"},
    State.VERIFYING: {"Comply"},
    State.RETREATING: {"MoveLinear", "Comply"},
}


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("command", MOTIONS, ids=lambda command: type(command).__name__)
def test_each_kind_of_motion_is_one_of_its_own_states_and_of_no_other(command: Command, state: State) -> None:
    known = rule(command, situation(state)) != "state"
    assert known is (type(command).__name__ in MOVED_IN.get(state, set()))


# --- an inserted plug -----------------------------------------------------------------------------------------------


def test_before_contact_the_proximity_contact_alone_says_whether_the_plug_is_in() -> None:
    """The TCP may be lower than the rim plane beside the vehicle."""
    beside = situation(State.STAGING, depth_m=0.05)
    assert rule(MoveJoints(tcp_at(-0.1), 0.5, 1.0), beside) is None
    assert rule(MoveJoints(tcp_at(-0.1), 0.5, 1.0), replace(beside, T_base_port=None)) is None


def test_from_contact_on_the_plug_is_in_from_the_rim_plane_on() -> None:
    aside = moving(0.01, 0, 0, 0, 0, 0)
    assert rule(aside, at_origin(State.INSERTING, before_origin(0.0))) is None
    assert rule(aside, at_origin(State.INSERTING, before_origin(1e-9))) == "inserted"


def test_from_contact_on_an_unknown_place_counts_as_inserted() -> None:
    aside = moving(0.01, 0, 0, 0, 0, 0)
    assert rule(aside, replace(situation(State.INSERTING), T_base_port=None)) == "inserted"
    assert rule(aside, at_origin(State.INSERTING, NAN_POSE)) == "inserted"
    out = MoveLinear(before_origin(-0.09), 0.02, 0.3)
    assert rule(out, at_origin(State.RETREATING, NAN_POSE)) == "inserted"


@pytest.mark.parametrize("turn", range(4))
def test_sideways_travel_up_to_the_capture_radius_is_allowed_and_no_more(turn: int) -> None:
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn]
    for sideways_m, inserted, axis_rule in ((0.002, None, None), (above(0.002), "inserted", "axis")):
        target = before_origin(-0.09, c * sideways_m, s * sideways_m)
        assert rule(MoveLinear(target, 0.02, 0.3), IN_PORT) == inserted
        assert rule(BackOff(target, 0.02, 0.3), at_origin(State.APPROACHING, before_origin(-0.03))) == axis_rule


def test_sideways_travel_counts_from_where_the_arm_is() -> None:
    out = MoveLinear(before_origin(-0.09, x_m=0.0015), 0.02, 0.3)
    here = replace(IN_PORT, arm=arm_at(before_origin(0.02, x_m=0.0015)))
    across = replace(IN_PORT, arm=arm_at(before_origin(0.02, x_m=-0.0015)))
    assert rule(out, here) is None
    assert rule(out, across) == "inserted"


@pytest.mark.parametrize("port_turn", [(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.0, -0.7, 0.3)])
def test_in_the_port_a_velocity_is_bounded_across_the_axis_and_free_along_it(port_turn: tuple[float, ...]) -> None:
    port = Pose.from_rotvec(port_turn, (0.5, 0.0, 0.3))
    inside = replace(
        situation(State.INSERTING, proximity=Proximity.INSERTED),
        arm=arm_at(port @ before_origin(0.02)),
        T_base_port=port,
    )
    for across in ((1.0, 0.0), (0.0, 1.0)):
        inwards = port.rotate(np.array([*np.multiply(across, 0.0019), -0.010]))
        aside = port.rotate(np.array([*np.multiply(across, 0.0021), -0.010]))
        assert rule(moving(*inwards, 0, 0, 0), inside) is None
        assert rule(moving(*aside, 0, 0, 0), inside) == "inserted"


@pytest.mark.parametrize("about", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)])
def test_in_the_port_a_force_may_be_tilted_by_a_fiftieth_and_no_more(about: tuple[float, ...]) -> None:
    inside = at_origin(State.INSERTING, before_origin(0.02), proximity=Proximity.INSERTED)
    for tilt_rad, rule_name in ((0.0199, None), (0.0201, "inserted"), (np.nan, "inserted")):
        tilted = compliance(T_base_task=Pose.from_rotvec(np.multiply(about, tilt_rad)))
        assert rule(tilted, inside) == rule_name
