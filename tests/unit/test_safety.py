"""The gate: which command is refused when, and by which rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.commands import (
    Announce,
    AskCharger,
    BackOff,
    Command,
    Comply,
    Laser,
    MoveJoints,
    MoveLinear,
    MoveVelocity,
    SetOutput,
    StopMotion,
    ZeroForce,
)
from controller.planning import FACING
from controller.safety import check, makes_safe
from controller.situation import Limits, Situation
from controller.states import State
from drivers.base import (
    ArmState,
    ChargerRequest,
    ChargerState,
    ChargerStatus,
    Compliance,
    Pilot,
    PlugLock,
    Proximity,
    RobotMode,
    SafetyMode,
)
from perception.geometry import Pose

LIMITS = Limits(
    workspace_min_m=(-1.3, -1.3, -0.3),
    workspace_max_m=(1.3, 1.3, 1.3),
    joint_speed_rad_s=0.7,
    linear_speed_m_s=0.08,
    insertion_speed_m_s=0.015,
    withdraw_speed_m_s=0.025,
    insertion_turn_rad_s=0.06,
    axial_force_n=80.0,
    lateral_force_n=30.0,
    moment_nm=6.0,
    capture_radius_m=0.002,
)
PORT = Pose(np.eye(3), np.array([0.5, 0.0, 0.3]))
"""A port that faces up: insertion is downwards."""


def tcp_at(depth_m: float, x_m: float = 0.0) -> Pose:
    return PORT @ Pose(FACING, np.array([x_m, 0.0, -depth_m]))


def arm_at(T_base_tcp: Pose, **changes: object) -> ArmState:
    state = ArmState(
        time_s=0.0,
        device_time_s=0.0,
        T_base_tcp=T_base_tcp,
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
    return replace(state, **changes)  # type: ignore[arg-type]


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


def situation(state: State, depth_m: float = -0.05, **charger: object) -> Situation:
    status = replace(CHARGER, **charger)  # type: ignore[arg-type]
    return Situation(state, arm_at(tcp_at(depth_m)), status, PORT)


def rule(command: Command, now: Situation) -> str | None:
    refusal = check(command, now, LIMITS)
    return None if refusal is None else refusal.rule


def compliance(push_n: float = 60.0, **changes: object) -> Comply:
    task = Pose(PORT.rotation @ FACING, PORT.translation)
    values = Compliance(task, (True,) * 6, (0, 0, push_n, 0, 0, 0), (0.01, 0.01, 0.015, 0.05, 0.05, 0.05))
    return Comply(replace(values, **changes))  # type: ignore[arg-type]


DOWN = MoveVelocity(np.array([0, 0, -0.01, 0, 0, 0.0]), 0.2)
TO_RETREAT = MoveLinear(tcp_at(-0.09), 0.02, 0.3)

MOTIONS: list[Command] = [MoveJoints(tcp_at(-0.1), 0.5, 1.0), TO_RETREAT, DOWN, compliance()]


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize(
    "command", [StopMotion(), Laser(on=False), Announce(None), AskCharger(ChargerRequest.STOP_POWER)]
)
def test_what_makes_safe_is_allowed_in_every_state_and_blindly(state: State, command: Command) -> None:
    assert rule(command, Situation(state, None, None)) is None


@pytest.mark.parametrize("state", [State.FAULT, State.OFFLINE, State.READY, State.HOLD, State.CHARGING, State.LOCATING])
@pytest.mark.parametrize("command", MOTIONS)
def test_nothing_moves_in_states_without_motion(state: State, command: Command) -> None:
    assert rule(command, situation(state)) == "state"


def test_each_motion_is_allowed_in_its_own_state() -> None:
    assert rule(MOTIONS[0], situation(State.STAGING)) is None
    assert rule(TO_RETREAT, situation(State.APPROACHING)) is None
    assert rule(DOWN, situation(State.INSERTING)) is None
    assert rule(compliance(), situation(State.INSERTING)) is None
    assert rule(TO_RETREAT, situation(State.RETREATING)) is None


@pytest.mark.parametrize("mode", [m for m in RobotMode if m is not RobotMode.RUNNING])
def test_no_motion_unless_the_robot_runs(mode: RobotMode) -> None:
    now = replace(situation(State.STAGING), arm=arm_at(tcp_at(-0.1), mode=mode))
    assert rule(MOTIONS[0], now) == "arm"


@pytest.mark.parametrize("safety", [m for m in SafetyMode if m not in (SafetyMode.NORMAL, SafetyMode.REDUCED)])
def test_no_motion_in_a_safety_stop(safety: SafetyMode) -> None:
    now = replace(situation(State.STAGING), arm=arm_at(tcp_at(-0.1), safety=safety))
    assert rule(MOTIONS[0], now) == "arm"


def test_no_motion_without_fresh_arm_or_charger() -> None:
    assert rule(MOTIONS[0], replace(situation(State.STAGING), arm=None)) == "arm"
    assert rule(MOTIONS[0], replace(situation(State.STAGING), charger=None)) == "charger"


def test_the_charger_can_inhibit_motion() -> None:
    assert rule(DOWN, situation(State.INSERTING, motion_inhibit=True)) == "charger"
    for state in (ChargerState.ESTOP, ChargerState.FAULT):  # whatever the bit says
        now = replace(situation(State.INSERTING), charger=replace(CHARGER, state=state))
        assert rule(DOWN, now) == "charger"
        assert said(OUT, replace(BEFORE_PORT, charger=now.charger)) == "charger: the charger inhibits motion"
    assert rule(DOWN, situation(State.INSERTING, estop=True)) == "charger"


def test_targets_outside_the_workspace_or_not_finite_are_refused() -> None:
    far = MoveLinear(Pose(np.eye(3), np.array([1.31, 0, 0])), 0.05, 0.3)
    nan = MoveLinear(Pose(np.eye(3), np.array([np.nan, 0, 0])), 0.05, 0.3)
    assert rule(far, situation(State.APPROACHING)) == "workspace"
    assert rule(nan, situation(State.APPROACHING)) == "target"


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_speeds_beyond_the_limit_or_not_finite_never_pass(speed: float) -> None:
    allowed = rule(MoveLinear(tcp_at(-0.1), speed, 0.3), situation(State.APPROACHING)) is None
    assert allowed == (0 < speed <= LIMITS.linear_speed_m_s)


@pytest.mark.parametrize(
    "wrench", [(0, 0, 81, 0, 0, 0), (25, 25, 0, 0, 0, 0), (0, 0, 10, 0, 7, 0), (0, 0, np.nan, 0, 0, 0)]
)
def test_forces_and_moments_over_the_cap_are_refused(wrench: tuple[float, ...]) -> None:
    assert rule(compliance(wrench=wrench), situation(State.INSERTING)) == "force"


def test_a_compliant_axis_may_not_be_faster_than_the_insertion_speed() -> None:
    quick = compliance(limits=(0.01, 0.01, 0.02, 0.05, 0.05, 0.05))
    assert rule(quick, situation(State.INSERTING)) == "speed"
    assert rule(quick, situation(State.RETREATING)) is None


def test_an_inserted_plug_moves_only_along_the_ports_axis() -> None:
    inside = situation(State.RETREATING, depth_m=0.02, proximity=Proximity.INSERTED)
    assert rule(MoveLinear(tcp_at(-0.09), 0.02, 0.3), inside) is None
    assert rule(MoveLinear(tcp_at(-0.09, x_m=0.0025), 0.02, 0.3), inside) == "inserted"
    tilted = compliance(T_base_task=Pose.from_rotvec([0.1, 0, 0]) @ PORT)
    assert rule(tilted, situation(State.INSERTING, depth_m=0.02)) == "inserted"


def test_proximity_alone_is_enough_to_count_as_inserted() -> None:
    sensed = situation(State.STAGING, depth_m=-0.2, proximity=Proximity.LATCHED)
    assert rule(MoveJoints(tcp_at(-0.1), 0.5, 1.0), sensed) == "inserted"


def test_no_retreat_while_the_lock_is_not_known_to_be_open() -> None:
    for lock in set(PlugLock) - {PlugLock.UNLOCKED}:
        locked = situation(State.RETREATING, depth_m=0.03, proximity=Proximity.LATCHED, lock=lock)
        assert rule(TO_RETREAT, locked) == "lock"


@pytest.mark.parametrize(
    "live", [{"contactor_closed": True}, {"current_a": 1.0}, {"electrical_time_s": -np.inf}, {"current_a": np.nan}]
)
def test_a_live_plug_is_neither_unlocked_nor_pulled(live: dict[str, object]) -> None:
    mated = replace(situation(State.RETREATING, depth_m=0.03, proximity=Proximity.INSERTED, **live), mated=True)
    assert rule(TO_RETREAT, mated) == "live"
    assert rule(AskCharger(ChargerRequest.UNLOCK_PLUG), replace(mated, state=State.RELEASING)) == "unlock"


def test_power_needs_a_mated_plug() -> None:
    charging = situation(State.CHARGING, proximity=Proximity.LATCHED, lock=PlugLock.LOCKED)
    assert rule(AskCharger(ChargerRequest.ENABLE_POWER), charging) == "power"
    assert rule(AskCharger(ChargerRequest.ENABLE_POWER), replace(charging, mated=True)) is None
    for state in set(State) - {State.CHARGING}:
        assert rule(AskCharger(ChargerRequest.ENABLE_POWER), replace(charging, state=state, mated=True)) is not None


@pytest.mark.parametrize(
    "changes",
    [
        {"proximity": Proximity.ABSENT},
        {"proximity": Proximity.FAULT},
        {"proximity": Proximity.RELEASE_PRESSED},
        {"lock": PlugLock.UNLOCKED},
        {"lock": PlugLock.LOCKING},
        {"lock": PlugLock.FAULT},
    ],
)
def test_power_needs_a_charger_that_says_just_now_that_the_plug_is_in_and_locked(changes: dict[str, object]) -> None:
    good = {"proximity": Proximity.LATCHED, "lock": PlugLock.LOCKED}
    assert rule(AskCharger(ChargerRequest.ENABLE_POWER), replace(situation(State.CHARGING, **good), mated=True)) is None
    poor = replace(situation(State.CHARGING, **good | changes), mated=True)
    assert rule(AskCharger(ChargerRequest.ENABLE_POWER), poor) == "power"


def test_no_power_is_wanted_of_a_silent_charger() -> None:
    silent = replace(situation(State.CHARGING), mated=True, charger=None)
    assert rule(AskCharger(ChargerRequest.ENABLE_POWER), silent) == "power"


def test_the_force_sensor_is_zeroed_only_at_rest_and_out_of_contact() -> None:
    assert rule(ZeroForce(), situation(State.INSERTING, depth_m=-0.03)) is None
    assert rule(ZeroForce(), situation(State.INSERTING, depth_m=0.001)) == "zero-force"
    assert rule(ZeroForce(), situation(State.SELF_CHECK, proximity=Proximity.INSERTED)) == "zero-force"
    moving = replace(situation(State.SELF_CHECK), arm=arm_at(tcp_at(-0.1), tcp_speed=np.full(6, 0.01)))
    assert rule(ZeroForce(), moving) == "zero-force"


@pytest.mark.parametrize("state", [s for s in State if s is not State.SCANNING])
def test_the_laser_is_on_only_while_scanning(state: State) -> None:
    assert rule(Laser(on=True), situation(state)) == "laser"


def test_the_laser_may_be_on_while_scanning() -> None:
    assert rule(Laser(on=True), situation(State.SCANNING)) is None


OUT = BackOff(tcp_at(-0.09), 0.05, 0.3)
BEFORE_PORT = Situation(State.APPROACHING, arm_at(tcp_at(-0.03)), None, PORT)


def said(command: Command, now: Situation) -> str:
    return str(check(command, now, LIMITS))


def test_before_contact_the_arm_may_back_off_although_the_charger_is_silent() -> None:
    assert rule(OUT, BEFORE_PORT) is None
    assert rule(OUT, replace(BEFORE_PORT, charger=CHARGER)) is None
    assert rule(BackOff(tcp_at(-0.09), LIMITS.linear_speed_m_s, 0.3), BEFORE_PORT) is None
    assert rule(OUT, replace(BEFORE_PORT, arm=arm_at(tcp_at(-0.03), safety=SafetyMode.REDUCED))) is None
    assert rule(OUT, replace(BEFORE_PORT, arm=arm_at(tcp_at(0.0)))) is None, "the rim plane is not yet contact"


@pytest.mark.parametrize("state", [s for s in State if s is not State.APPROACHING])
def test_backing_off_is_a_motion_of_the_approach_alone(state: State) -> None:
    assert said(OUT, replace(BEFORE_PORT, state=state)) == f"state: BackOff in {state.name}"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"T_base_port": None}, "state: BackOff in APPROACHING"),
        ({"arm": None}, "arm: the arm's state is not fresh, or it is not running"),
        (
            {"arm": arm_at(tcp_at(-0.03), mode=RobotMode.IDLE)},
            "arm: the arm's state is not fresh, or it is not running",
        ),
        ({"arm": arm_at(tcp_at(-0.03), safety=SafetyMode.SAFEGUARD_STOP)}, "arm: safety mode SAFEGUARD_STOP"),
        ({"charger": replace(CHARGER, estop=True)}, "charger: the charger inhibits motion"),
        ({"charger": replace(CHARGER, motion_inhibit=True)}, "charger: the charger inhibits motion"),
        ({"arm": arm_at(tcp_at(-0.03), wrench=np.array([0, 0, 10.0, 9, 9, 9]))}, "contact: 10.0 N at the plug"),
        ({"arm": arm_at(tcp_at(-0.03), wrench=np.full(6, np.nan))}, "contact: nan N at the plug"),
        ({"arm": arm_at(tcp_at(0.001))}, "axis: only from before the rim, and only outwards"),
        ({"arm": arm_at(tcp_at(-0.09))}, "axis: only from before the rim, and only outwards"),
    ],
)
def test_backing_off_is_refused_with_the_reason(changes: dict[str, object], text: str) -> None:
    assert said(OUT, replace(BEFORE_PORT, **changes)) == text  # type: ignore[arg-type]


def test_a_torque_alone_or_a_light_touch_is_no_contact() -> None:
    light = arm_at(tcp_at(-0.03), wrench=np.array([0, 0, 9.9, 50, 50, 50]))
    assert rule(OUT, replace(BEFORE_PORT, arm=light)) is None


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (BackOff(tcp_at(-0.09), 0.0, 0.3), "speed: 0.0 mm/s"),
        (BackOff(tcp_at(-0.09), 0.0801, 0.3), "speed: 80.1 mm/s"),
        (BackOff(tcp_at(-0.09, x_m=0.0021), 0.05, 0.3), "axis: 2.1 mm sideways"),
        (BackOff(tcp_at(-1.1), 0.05, 0.3), "workspace: target [500, 0, 1400] mm is outside"),
    ],
)
def test_backing_off_goes_straight_out_slowly_and_stays_in_the_workspace(command: Command, text: str) -> None:
    assert said(command, BEFORE_PORT) == text


def test_exactly_the_capture_radius_sideways_is_allowed() -> None:
    assert rule(BackOff(tcp_at(-0.09, x_m=0.0019999), 0.05, 0.3), BEFORE_PORT) is None


SEEN_OUT = situation(State.APPROACHING)


@pytest.mark.parametrize(
    ("command", "now", "text"),
    [
        (Laser(on=True), situation(State.READY), "laser: laser on in READY"),
        (SetOutput(1, True), situation(State.READY), "trigger: trigger in READY"),
        (ZeroForce(), situation(State.READY), "zero-force: not in READY"),
        (ZeroForce(), replace(SEEN_OUT, charger=None), "zero-force: only with no plug inserted"),
        (ZeroForce(), replace(SEEN_OUT, arm=None), "zero-force: only with the arm at rest"),
        (ZeroForce(), situation(State.APPROACHING, depth_m=0.001), "zero-force: only out of contact"),
        (AskCharger(ChargerRequest.LOCK_PLUG), situation(State.READY), "charger-request: LOCK_PLUG in READY"),
        (TO_RETREAT, situation(State.READY), "state: MoveLinear in READY"),
        (TO_RETREAT, replace(SEEN_OUT, arm=None), "arm: the arm's state is not fresh"),
        (TO_RETREAT, replace(SEEN_OUT, charger=None), "charger: the charger's status is not fresh"),
        (TO_RETREAT, replace(SEEN_OUT, charger=replace(CHARGER, estop=True)), "charger: the charger inhibits motion"),
        (TO_RETREAT, replace(SEEN_OUT, arm=arm_at(tcp_at(-0.1), mode=RobotMode.IDLE)), "arm: robot mode IDLE"),
        (
            TO_RETREAT,
            replace(SEEN_OUT, arm=arm_at(tcp_at(-0.1), safety=SafetyMode.FAULT)),
            "arm: safety mode FAULT",
        ),
        (MoveJoints(tcp_at(-0.1), 1.0, 1.0), situation(State.STAGING), "speed: 57.3 deg/s"),
        (MoveLinear(tcp_at(-0.1), 0.1, 0.3), SEEN_OUT, "speed: 100.0 mm/s, at most 80.0"),
        (
            MoveLinear(tcp_at(-0.1), 0.03, 0.3),
            situation(State.RETREATING, 0.01, proximity=Proximity.INSERTED),
            "speed: 30.0 mm/s, at most 25.0",
        ),
        (
            MoveVelocity(np.array([0, 0, 0.0]), 0.2),
            situation(State.INSERTING),
            "speed: a velocity is six finite numbers",
        ),
        (
            MoveVelocity(np.array([0, 0, 0, 0, 0, np.inf]), 0.2),
            situation(State.INSERTING),
            "speed: a velocity is six finite numbers",
        ),
        (MoveVelocity(np.array([0, 0, -0.0151, 0, 0, 0]), 0.2), situation(State.INSERTING), "speed: 15.1 mm/s"),
        (MoveVelocity(np.array([0, 0, 0, 0, 0, 0.1]), 0.2), situation(State.INSERTING), "speed: 5.7 deg/s"),
        (
            compliance(limits=(0.01, 0.01, 0.0, 0.05, 0.05, 0.05)),
            situation(State.INSERTING),
            "force: wrench and limits must be finite, limits positive",
        ),
        (
            compliance(wrench=(0, 0, -81, 0, 0, 0)),
            situation(State.INSERTING),
            "force: [0, 0, -81] N is over the cap",
        ),
        (compliance(wrench=(0, 0, 0, 6.1, 0, 0)), situation(State.INSERTING), "force: 6.1 Nm is over the cap"),
        (
            compliance(limits=(0.01, 0.01, 0.016, 0.05, 0.05, 0.05)),
            situation(State.INSERTING),
            "speed: a compliant axis may move faster than allowed",
        ),
        (
            compliance(limits=(0.01, 0.01, 0.015, 0.05, 0.05, 0.07)),
            situation(State.INSERTING),
            "speed: a compliant axis may turn faster than allowed",
        ),
        (
            MoveLinear(Pose(np.full((3, 3), np.nan), np.zeros(3)), 0.05, 0.3),
            SEEN_OUT,
            "target: not finite",
        ),
    ],
)
def test_a_refusal_says_by_which_rule_and_why(command: Command, now: Situation, text: str) -> None:
    assert said(command, now) == text


@pytest.mark.parametrize(
    ("command", "safe"),
    [
        (StopMotion(), True),
        (Announce(None), True),
        (Laser(on=False), True),
        (Laser(on=True), False),
        (ZeroForce(), False),
        (TO_RETREAT, False),
        *(
            (AskCharger(r), r in (ChargerRequest.NONE, ChargerRequest.STOP_POWER, ChargerRequest.ABORT))
            for r in ChargerRequest
        ),
    ],
)
def test_what_makes_safe_is_known(command: Command, safe: bool) -> None:
    assert makes_safe(command) is safe


def test_an_output_may_be_high_while_scanning_and_low_always() -> None:
    assert rule(SetOutput(1, True), situation(State.SCANNING)) is None
    assert rule(SetOutput(1, False), situation(State.READY)) is None


def test_what_is_exactly_at_a_limit_is_allowed() -> None:
    inserting = situation(State.INSERTING)
    assert rule(MoveVelocity(np.array([0, 0, -0.015, 0.06, 0, 0]), 0.2), inserting) is None
    assert rule(compliance(wrench=(30, 0, 80, 0, 6, 0)), inserting) is None
    assert rule(compliance(limits=(0.01, 0.01, 0.015, 0.06, 0.06, 0.06)), inserting) is None
    assert rule(MoveJoints(tcp_at(-0.1), 0.7, 1.0), situation(State.STAGING)) is None
    corner = MoveLinear(Pose(np.eye(3), np.array([1.3, -1.3, 1.3])), 0.08, 0.3)
    assert rule(corner, SEEN_OUT) is None


def test_the_speed_of_an_axis_that_does_not_comply_is_of_no_concern() -> None:
    stiff = compliance(selection=(False,) * 2 + (True,) + (False,) * 3, limits=(1.0, 1.0, 0.015, 1.0, 1.0, 1.0))
    assert rule(stiff, situation(State.INSERTING)) is None


def test_sideways_in_the_port_the_reason_names_how_far() -> None:
    inside = situation(State.RETREATING, depth_m=0.02, proximity=Proximity.INSERTED)
    assert said(MoveLinear(tcp_at(-0.09, x_m=0.003), 0.02, 0.3), inside) == (
        "inserted: 3.0 mm sideways while the plug is in the port"
    )
    aside = MoveVelocity(np.array([0.003, 0, 0, 0, 0, 0]), 0.2)
    assert said(aside, situation(State.INSERTING, depth_m=0.02)).startswith("inserted: 3.0 mm")
    nowhere = replace(inside, T_base_port=None)
    assert said(MoveLinear(tcp_at(-0.09), 0.02, 0.3), nowhere) == (
        "inserted: the axis on which the plug was inserted is not known"
    )
    sensed = situation(State.STAGING, proximity=Proximity.INSERTED)
    assert said(MoveJoints(tcp_at(-0.1), 0.5, 1.0), sensed) == (
        "inserted: no joint motion while the plug is in the port"
    )


def test_a_live_or_locked_plug_is_named_with_what_makes_it_so() -> None:
    mated = situation(State.RETREATING, depth_m=0.03, proximity=Proximity.INSERTED)

    def live(**charger: object) -> str:
        return said(TO_RETREAT, replace(mated, charger=replace(mated.charger, **charger)))  # type: ignore[type-var]

    assert live(contactor_closed=True) == "live: the contactor is closed"
    assert live(current_a=np.nan) == "live: the current is not measured, or not fresh"
    assert live(current_a=-1.5) == "live: 1.5 A are flowing" or live(current_a=-1.5) == "live: -1.5 A are flowing"
    assert live(lock=PlugLock.LOCKED) == "lock: the plug is not known to be unlocked"
    assert said(AskCharger(ChargerRequest.UNLOCK_PLUG), replace(mated, state=State.RELEASING, charger=None)) == (
        "unlock: the charger is silent: the contactor's state is unknown"
    )


def test_why_power_is_not_wanted_is_named() -> None:
    ready = situation(State.CHARGING, proximity=Proximity.LATCHED, lock=PlugLock.LOCKED)
    power = AskCharger(ChargerRequest.ENABLE_POWER)
    assert said(power, ready) == "power: the plug is not mated: depth, force plateau and proximity are all needed"
    mated = replace(ready, mated=True)
    assert said(power, replace(mated, charger=None)) == (
        "power: the charger is silent: whether the plug is still in is unknown"
    )
    absent = replace(mated, charger=replace(CHARGER, proximity=Proximity.ABSENT))
    assert said(power, absent) == "power: the proximity contact says ABSENT"
    unlocked = replace(mated, charger=replace(CHARGER, proximity=Proximity.INSERTED))
    assert said(power, unlocked) == "power: the plug's lock is UNLOCKED"
