"""The last centimetres on the emulated arm and port: contact, push, jam, search, withdrawal, and their bounds."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from controller.config import load_config
from controller.faults import FaultCode, MissionFault
from controller.insertion import Insertion, Verdict, insert
from controller.insertion_config import InsertionConfig
from controller.states import State
from controller.withdrawal import withdraw
from drivers.base import PlugLock
from mocks.world import contact
from perception.geometry import Pose
from tests.insertion_rig import DT, InsertionRig

log = logging.getLogger(__name__)

PATIENCE_S = 60.0


def off(x_mm: float = 0.0, y_mm: float = 0.0, tilt_deg: float = 0.0, roll_deg: float = 0.0) -> Pose:
    return Pose.from_rotvec(np.deg2rad([tilt_deg, 0.0, roll_deg]), np.array([x_mm, y_mm, 0.0]) / 1000.0)


def make(folder: Path, error: Pose, seed: int = 1, **world: object) -> InsertionRig:
    return InsertionRig(folder, error, np.random.default_rng(seed), **world)  # type: ignore[arg-type]


def change(rig: InsertionRig, **values: object) -> None:
    rig.settings = rig.settings.model_copy(update=values)


def run(rig: InsertionRig, search: bool = False, timeout_s: float = PATIENCE_S) -> Insertion:
    return insert(rig.cell, rig.plan, rig.settings, search=search, timeout_s=timeout_s)


def moves_after_stop(rig: InsertionRig) -> float:
    """How far the TCP still goes, m, once the last stop has had time to work."""
    rig.arm.run(0.5)
    before = rig.arm.state().T_base_tcp
    rig.arm.run(1.0)
    return rig.arm.state().T_base_tcp.distance_to(before)


# --- contact and push -------------------------------------------------------------------------------------------------


def test_a_well_placed_plug_is_seated_and_held(tmp_path: Path) -> None:
    rig = make(tmp_path, off(0.4, -0.3, 0.5, 0.5))
    result = run(rig)
    assert result.verdict is Verdict.SEATED, result.detail
    assert rig.board.plug().seated
    assert rig.arm.mock.force_mode is not None, "the seating force stays on for the lock"
    assert result.contact.along_m == pytest.approx(0.0, abs=0.002)


def test_the_trace_has_every_sample_of_the_arms_state(tmp_path: Path) -> None:
    result = run(make(tmp_path, off()))
    times = np.array([sample.time_s for sample in result.trace])
    assert np.diff(times) == pytest.approx(DT)
    last = result.trace[-1]
    assert last.depth_m > 0.047 and last.axial_n > 30.0
    assert max(sample.lateral_n for sample in result.trace) >= 0.0 and last.moment_nm < 2.0


def test_contact_is_met_slowly_and_gently(tmp_path: Path) -> None:
    rig = make(tmp_path, off(4.0))
    speeds, forces = [], []

    def note() -> None:
        if not any(name == "Comply" for name, _ in rig.commands.given):
            speeds.append(float(np.linalg.norm(rig.arm.mock.tool_speed()[:3])))
            forces.append(float(np.linalg.norm(rig.arm.mock.true_wrench[:3])))

    rig.arm.before_step = note
    run(rig)
    assert max(speeds) < 1.05 * rig.settings.contact_speed_mm_s / 1000.0
    assert rig.settings.contact_force_n * 0.5 < max(forces) < 30.0


def test_nothing_to_touch_and_no_progress_ends_in_time(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    rig.arm.mock.slider = 0.0
    with pytest.raises(MissionFault) as caught:
        run(rig, timeout_s=3.0)
    assert caught.value.fault.code is FaultCode.MOTION_FAILED


def test_a_blocked_port_is_a_stall_and_the_arm_stops(tmp_path: Path) -> None:
    rig = make(tmp_path, off(), blocked_depth_m=0.02)
    result = run(rig, search=True)
    assert result.verdict is Verdict.STALLED
    assert result.contact.along_m == pytest.approx(0.028, abs=0.002)
    assert rig.arm.mock.force_mode is None
    assert moves_after_stop(rig) < 1e-5
    assert not any("MoveVelocity" in name for name, _ in rig.commands.given[4:]), "nothing is searched inside a port"


def test_force_above_a_cap_stops_at_once(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    jam(rig, 45.0)
    result = run(rig)
    assert result.verdict is Verdict.OVERLOAD
    over = [sample.time_s for sample in result.trace if sample.lateral_n > rig.settings.max_lateral_force_n]
    assert result.trace[-1].time_s - over[0] < 0.1
    assert rig.arm.mock.force_mode is None
    assert moves_after_stop(rig) < 1e-5


def test_one_noisy_sample_is_no_overload(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    touch, spiked = rig.arm.mock.environment.step, []

    def step(T_base_flange: np.ndarray, dt: float) -> np.ndarray:
        wrench = touch(T_base_flange, dt)
        if rig.depth_m > 0.02 and not spiked:
            spiked.append(rig.depth_m)
            wrench[:3] += 200.0
        return wrench

    rig.arm.mock.environment.step = step  # type: ignore[method-assign]
    assert run(rig).verdict is Verdict.SEATED
    assert spiked


def test_a_port_deeper_than_it_can_be_is_an_overrun(tmp_path: Path) -> None:
    rig = make(tmp_path, Pose(np.eye(3), np.array([0.0, 0.0, 0.008])))
    result = run(rig)
    assert result.verdict is Verdict.OVERRUN
    assert moves_after_stop(rig) < 1e-5


# --- jam --------------------------------------------------------------------------------------------------------------


def jam(rig: InsertionRig, lateral_n: float) -> None:
    """Something holds the plug at 10 mm and presses on its side until it has been eased back once; the arm hardly
    yields sideways, or it would give way until nothing presses."""
    change(rig, lateral_speed_limit_mm_s=0.05)
    touch, state = rig.arm.mock.environment.step, {"eased": False}

    def step(T_base_flange: np.ndarray, dt: float) -> np.ndarray:
        wrench = touch(T_base_flange, dt)
        depth = rig.depth_m
        state["eased"] |= rig.arm.mock.force_mode is not None and rig.arm.mock.force_mode.wrench[2] < 0.0
        if depth > 0.010 and not state["eased"]:
            port = rig.truth.rotation
            wrench[:3] += port @ np.array([lateral_n, 0.0, 30e3 * (depth - 0.010)])
        return wrench

    rig.arm.mock.environment.step = step  # type: ignore[method-assign]


def test_a_jammed_plug_is_eased_back_and_then_goes_home(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    jam(rig, 18.0)
    result = run(rig)
    assert result.verdict is Verdict.SEATED, result.detail
    pulls = [detail for name, detail in rig.commands.given if name == "Comply" and "-30" in detail]
    assert len(pulls) == 1


def test_a_jam_that_does_not_ease_is_called_one(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    jam(rig, 18.0)
    change(rig, jam_retries=0)
    result = run(rig)
    assert result.verdict is Verdict.JAMMED
    assert "lateral" in result.detail
    assert moves_after_stop(rig) < 1e-5


def test_a_stall_without_force_across_is_no_jam(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    jam(rig, 0.0)
    assert run(rig).verdict is Verdict.STALLED


# --- search -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [off(3.4), off(0.0, -3.2), off(-2.3, 2.3), off(2.0, 0.0, 0.0, 3.6)])
def test_a_plug_just_beside_the_port_is_led_in(tmp_path: Path, error: Pose) -> None:
    rig = make(tmp_path, error)
    assert run(rig).verdict is Verdict.STALLED, "a straight push does not do"
    rig = make(tmp_path, error)
    result = run(rig, search=True)
    assert result.verdict is Verdict.SEATED, result.detail
    assert rig.arm.peak_n < 1.1 * rig.settings.max_axial_force_n


def test_the_search_keeps_within_radius_turn_and_force(tmp_path: Path) -> None:
    rig = make(tmp_path, off(12.0))
    result = run(rig, search=True)
    assert result.verdict is Verdict.STALLED
    settings = rig.settings
    offsets = 1000.0 * np.array([sample.offset_m for sample in result.trace])
    assert 0.8 * settings.search_radius_mm < offsets.max() < settings.search_radius_mm + 0.3
    states = [rig.plan.T_base_port.inverse() @ state.T_base_tcp for state in rig.arm.states]
    rolls = [np.degrees((pose @ rig.plan.T_port_tcp_mated.inverse()).rotvec[2]) for pose in states]
    assert 0.5 * settings.search_roll_deg < np.abs(rolls).max() < settings.search_roll_deg + 0.5
    assert rig.arm.peak_n < 1.1 * settings.push_force_n
    assert moves_after_stop(rig) < 1e-5
    assert not [detail for _, detail in rig.commands.given if "REFUSED" in detail]


def test_the_search_ends_when_its_time_is_up(tmp_path: Path) -> None:
    rig = make(tmp_path, off(12.0))
    change(rig, search_s=1.5)
    begun = len(rig.arm.states)
    run(rig, search=True)
    assert (len(rig.arm.states) - begun) * DT < 10.0


# --- pulling out ------------------------------------------------------------------------------------------------------


def seated(folder: Path) -> InsertionRig:
    rig = make(folder, off(0.5, 0.2, 0.4, 0.3))
    assert run(rig).verdict is Verdict.SEATED
    rig.arm.stop()
    rig.in_state(State.RETREATING)
    return rig


def test_a_free_plug_comes_out_along_its_axis_with_bounded_force(tmp_path: Path) -> None:
    rig = seated(tmp_path)
    rig.arm.peak_n = 0.0
    first = len(rig.arm.states)
    withdraw(rig.cell, rig.plan, rig.settings, PATIENCE_S)
    assert rig.depth_m < -0.004
    assert rig.arm.peak_n < 1.1 * rig.settings.withdraw_force_n
    inverse = rig.plan.T_base_port.inverse()
    path = np.array([(inverse @ state.T_base_tcp).translation for state in rig.arm.states[first:]])
    assert np.ptp(path[:, :2], axis=0).max() < 0.001, "it leaves along the axis"
    assert moves_after_stop(rig) < 1e-5


def test_the_pull_begins_gently(tmp_path: Path) -> None:
    rig = seated(tmp_path)
    asked = len(rig.commands.given)
    withdraw(rig.cell, rig.plan, rig.settings, PATIENCE_S)
    pulls = [detail for name, detail in rig.commands.given[asked:] if name == "Comply"]
    assert f"-{rig.settings.withdraw_start_force_n}" in pulls[0]


def test_a_plug_that_is_held_is_pulled_with_no_more_than_the_bound_and_left(tmp_path: Path) -> None:
    rig = seated(tmp_path)
    rig.board.put_lock(True)  # the latch holds, whatever the charger says
    rig.arm.run(0.1)
    rig.arm.peak_n = 0.0
    with pytest.raises(MissionFault) as caught:
        withdraw(rig.cell, rig.plan, rig.settings, PATIENCE_S)
    rig.board.put_lock(False)
    assert caught.value.fault.code is FaultCode.WITHDRAWAL_BLOCKED
    assert 0.8 * rig.settings.withdraw_force_n < rig.arm.peak_n < 1.1 * rig.settings.withdraw_force_n
    assert rig.board.plug().seated or rig.depth_m > 0.04
    assert rig.arm.mock.force_mode is None


def test_a_plug_whose_lock_is_not_confirmed_open_is_not_pulled(tmp_path: Path) -> None:
    rig = seated(tmp_path)
    rig.charger.lock = PlugLock.LOCKED
    before = rig.arm.state().T_base_tcp
    with pytest.raises(MissionFault) as caught:
        withdraw(rig.cell, rig.plan, rig.settings, PATIENCE_S)
    assert "lock" in caught.value.fault.detail
    assert rig.arm.state().T_base_tcp.distance_to(before) < 1e-4


def test_a_lock_that_closes_during_the_pull_ends_it(tmp_path: Path) -> None:
    rig = seated(tmp_path)

    def lock_soon() -> None:
        if rig.depth_m < 0.0488:
            rig.charger.lock = PlugLock.LOCKED

    rig.arm.before_step = lock_soon
    with pytest.raises(MissionFault, match="unlocked"):
        withdraw(rig.cell, rig.plan, rig.settings, PATIENCE_S)
    assert rig.depth_m > 0.045


def test_after_a_failed_insertion_the_plug_backs_out_with_low_force(tmp_path: Path) -> None:
    rig = make(tmp_path, off(), blocked_depth_m=0.02)
    assert run(rig).verdict is Verdict.STALLED
    rig.in_state(State.RETREATING)
    rig.arm.run(0.5)
    rig.arm.peak_n = 0.0
    withdraw(rig.cell, rig.plan, rig.settings, PATIENCE_S)
    assert rig.depth_m < -0.004
    assert rig.arm.peak_n < 65.0, "no more than what was pressed against already"


def test_a_plug_that_is_out_is_left_alone(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    rig.in_state(State.RETREATING)
    withdraw(rig.cell, rig.plan, rig.settings, PATIENCE_S)
    assert rig.commands.given == []


# --- the true error of a mission --------------------------------------------------------------------------------------


def lateral_mm(rig: InsertionRig) -> float:
    return 1000.0 * rig.board.plug().lateral_m


def test_errors_of_calibration_and_arm_move_the_true_plug_not_the_reported_one(tmp_path: Path) -> None:
    exact = make(tmp_path, off())
    tool = make(tmp_path, off(), tool_error=off(1.5))
    arm = make(tmp_path, off(), joint_offsets=np.array([0.002, 0, 0, 0, 0, 0]))
    for rig in (exact, tool, arm):
        assert rig.arm.state().T_base_tcp.distance_to(rig.plan.pre_contact) < 1e-6
        rig.arm.run(DT)
    for rig, wanted_mm in ((exact, 0.0), (tool, 1.5), (arm, 1.9)):
        rig.arm.run(DT)
        assert lateral_mm(rig) == pytest.approx(wanted_mm, abs=0.15)


@pytest.mark.parametrize(
    ("sources", "verdict"),
    [
        ({}, Verdict.SEATED),
        ({"tool_error": off(1.2)}, Verdict.SEATED),
        ({"tool_error": off(3.0)}, Verdict.STALLED),
        ({"joint_offsets": np.array([0.0032, 0, 0, 0, 0, 0])}, Verdict.STALLED),
        ({"tool_error": off(0.0, 0.0, 0.0, 3.6)}, Verdict.STALLED),
    ],
)
def test_a_perfect_estimate_does_not_help_against_a_bad_calibration(tmp_path: Path, sources, verdict) -> None:
    rig = make(tmp_path, off(), **sources)
    assert run(rig).verdict is verdict
    assert rig.board.plug().seated is (verdict is Verdict.SEATED)


def test_localisation_and_calibration_errors_add_up(tmp_path: Path) -> None:
    along_x = make(tmp_path, off(1.6), tool_error=off(1.6))
    assert run(along_x).verdict is Verdict.STALLED
    cancelling = make(tmp_path, off(1.6), tool_error=off(-1.6))
    assert run(cancelling).verdict is Verdict.SEATED


def test_the_wrench_is_noisy_and_biased_until_zeroed(tmp_path: Path) -> None:
    rig = make(tmp_path, off())
    felt = np.array([state.wrench for state in rig.arm.history(0.0)])
    assert 0.1 < felt[:, :3].std(axis=0).max() < 1.0
    assert np.abs(felt[:, :3].mean(axis=0)).max() > 0.5
    rig.arm.zero_force_sensor()
    rig.arm.run(0.4)
    felt = np.array([state.wrench for state in rig.arm.states[-50:]])
    assert np.abs(felt[:, :3].mean(axis=0)).max() < 0.3


# --- per port type ----------------------------------------------------------------------------------------------------


def test_values_of_a_port_type_replace_only_what_they_name() -> None:
    config = InsertionConfig.model_validate({"push_force_n": 55.0, "per_port": {"j1772": {"stall_s": 2.0}}})
    assert (config.on("j1772").push_force_n, config.on("j1772").stall_s) == (55.0, 2.0)
    assert (config.on("ccs2").push_force_n, config.on("ccs2").stall_s) == (55.0, 1.0)
    assert InsertionConfig.model_validate(config.model_dump()) == config


def test_a_site_gets_the_values_of_its_port(tmp_path: Path) -> None:
    text = "insertion: {per_port: {j1772: {push_force_n: 44}}}\nport: {model: MODEL}"
    for model, push_n in (("j1772", 44.0), ("/ports/j1772.yaml", 44.0), ("type2", 60.0)):
        (tmp_path / "site.yaml").write_text(text.replace("MODEL", model))
        assert load_config(tmp_path / "site.yaml").insertion_here.push_force_n == push_n


def test_values_of_a_port_type_are_bounded_and_known_too() -> None:
    for wrong in ({"push_force_n": 500.0}, {"push_n": 50.0}):
        with pytest.raises(ValueError, match="push"):
            InsertionConfig.model_validate({"per_port": {"ccs2": wrong}})


def test_a_push_or_pull_beyond_the_cap_is_refused() -> None:
    for wrong in ({"push_force_n": 90.0}, {"withdraw_force_n": 81.0}, {"per_port": {"type2": {"push_force_n": 85.0}}}):
        with pytest.raises(ValueError, match="max_axial_force_n"):
            InsertionConfig.model_validate(wrong)


# --- many -------------------------------------------------------------------------------------------------------------


def draw(rng: np.random.Generator, spread: float) -> Pose:
    """Within and beyond capture, but not so close to its limits that the sensor's noise decides."""
    while True:
        lateral_mm, tilt_deg = spread * rng.uniform(-2.4, 2.4, 2), spread * rng.uniform(-2.1, 2.1, 2)
        roll_deg = spread * rng.uniform(-3.3, 3.3)
        gaps = (np.linalg.norm(lateral_mm) - 2.5, np.linalg.norm(tilt_deg) - 2.5, abs(roll_deg) - 3.0)
        if min(abs(gap) for gap in gaps) > 0.25:  # force control on a noisy sensor drifts by 0.2 mm now and then
            return Pose.from_rotvec(np.deg2rad([*tilt_deg, roll_deg]), [*(lateral_mm / 1000.0), 0.0])


def campaign(folder: Path, count: int, spread: float) -> list[tuple[bool, Insertion, bool, float]]:
    """(predicted to mate from the misalignment alone, result, truly seated, peak force) of each insertion."""
    rng, done = np.random.default_rng(11), []
    for number in range(count):
        error = draw(rng, spread)
        blocked = 0.02 if rng.uniform() < 0.1 else None
        noise = np.random.default_rng([11, number])  # its own: how long an insertion takes must not choose the next one
        rig = InsertionRig(folder, error, noise, blocked_depth_m=blocked, start_mm=5.0)
        port = contact.Port(Pose.from_vector(rig.world.T_port_tcp), blocked_depth_m=blocked)
        plug = contact.misalignment((rig.truth.inverse() @ rig.plan.pre_contact).matrix, port)
        predicted = contact.predict_outcome(plug, port) == "mates"
        done.append((predicted, run(rig), rig.board.plug().seated, rig.arm.peak_n))
    return done


def judge_all(done: list[tuple[bool, Insertion, bool, float]], cap_n: float) -> None:
    assert [seated for _, _, seated, _ in done] == [predicted for predicted, _, _, _ in done]
    assert [result.verdict is Verdict.SEATED for _, result, _, _ in done] == [predicted for predicted, _, _, _ in done]
    assert max(peak for _, _, _, peak in done) < 1.1 * cap_n


def test_insertions_end_as_their_misalignment_predicts(tmp_path: Path) -> None:
    done = campaign(tmp_path, 6, 1.0)
    judge_all(done, InsertionConfig().max_axial_force_n)
    assert {predicted for predicted, _, _, _ in done} == {True, False}


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_three_hundred_insertions_end_as_their_misalignment_predicts(tmp_path: Path) -> None:
    done = campaign(tmp_path, 300, 1.12)
    judge_all(done, InsertionConfig().max_axial_force_n)
    beyond = sum(not predicted for predicted, _, _, _ in done)
    log.info("%d of %d predicted to fail; peak force %.1f N", beyond, len(done), max(peak for *_, peak in done))
    assert 0.3 < beyond / len(done) < 0.7
