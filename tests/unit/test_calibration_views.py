"""The poses of a hand-eye calibration: what they differ in, what keeps the plug clear, what their choice foretells."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from controller.calibrations.hand_eye_session import Wanted
from controller.calibrations.port_sweeps import expected_skin
from controller.calibrations.pose_choice import Aim, PoseChoice
from controller.calibrations.views import CLEAR_M, View, candidates, reachable, sweep_of
from controller.config import load_config
from perception.calibration.errors import CalibrationError
from perception.calibration.foresight import Expected, Foreseen, Sweep, covariance_after, foreseen, spread
from perception.calibration.from_sweeps import TargetKind, solve_sweeps
from perception.calibration.hand_eye import Asked
from perception.calibration.sightings import Mounting
from perception.calibration.skins import FACE_M, corner_skin, expected_corner, sphere_skin
from perception.calibration.targets import PlanesTarget, SphereTarget
from perception.geometry import Pose
from tests.unit.calibration_rig import CENTRE, CORNER, T_FLANGE_SCANNER, Rig

CONFIG = load_config()
TARGET = CONFIG.port.T_base_port.pose
TCP = CONFIG.arm.T_flange_tcp.pose
MOUNTING = Mounting(CONFIG.scanner.T_flange_scanner.pose)
ROBOT = np.zeros(3)
KINDS = (TargetKind("sphere"), TargetKind("planes"), TargetKind("port", port="ccs2"))


def aim(kind: TargetKind = KINDS[0]) -> Aim:
    return Aim(MOUNTING, TARGET, expected_skin(kind, TARGET, None))


def choice(reach=lambda _: None) -> PoseChoice:
    return PoseChoice(CONFIG, Asked(), reach)


def told(view: View, kind: TargetKind = KINDS[0]) -> Foreseen:
    return choice().foreseen(view, aim(kind))


@pytest.mark.parametrize("kind", [KINDS[0], KINDS[2]], ids=lambda kind: kind.name)
def test_every_candidate_sees_the_target_whole(kind: TargetKind) -> None:
    square = told(View(), kind).points
    assert square > 300
    assert min(told(view, kind).points for view in candidates(12)) > 0.6 * square


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_sweeps_that_say_most_leave_the_mounting_less_uncertain_than_the_first_that_come(kind: TargetKind) -> None:
    one, at = choice(), aim(kind)
    made = [one.foreseen(View(), at)]
    for _ in range(5):
        made.append(one.foreseen(one.take(at, made), at))
    chosen = spread(covariance_after(made, Expected()))
    first = spread(covariance_after([told(View(), kind), *(told(view, kind) for view in candidates(5))], Expected()))
    assert chosen[0] ** 2 + (0.29 * chosen[1]) ** 2 < first[0] ** 2 + (0.29 * first[1]) ** 2
    assert np.isfinite(chosen).all()


def test_of_a_corner_only_poses_are_taken_that_see_all_three_faces() -> None:
    one, at = choice(), aim(KINDS[1])
    made = [one.foreseen(View(), at)]
    assert made[0].points > 300
    assert min(told(view, KINDS[1]).points for view in candidates(36)) == 0  # a face is hidden, or grazed
    for _ in range(14):
        made.append(one.foreseen(one.take(at, made), at))
    assert min(view.points for view in made) > 200


def test_each_pose_is_proposed_once_and_only_if_the_arm_can_reach_it() -> None:
    def reach(poses: list[Pose]) -> str | None:
        return None if poses[0].translation[1] < TARGET.translation[1] else "out of reach"

    one, at = choice(reach), aim()
    made, taken = [told(View())], []
    with pytest.raises(CalibrationError, match="no further pose about the target can be reached"):
        for _ in range(37):
            taken.append(one.take(at, made))
    assert len(set(taken)) == len(taken)
    possible = [view for view in candidates(36) if reachable(one.viewpoint(view, at), TARGET, reach) is None]
    assert set(taken) == set(possible)
    assert 0 < len(taken) < 36


def test_a_sweep_that_passes_by_the_target_foretells_nothing() -> None:
    skin = sphere_skin(SphereTarget(TARGET.translation + np.array([0.0, 0.4, 0.0]), 0.0254))
    assert choice().foreseen(View(), Aim(MOUNTING, TARGET, skin)).points == 0


def test_what_is_foretold_for_sweeps_of_a_corner_is_what_the_solver_states() -> None:
    scans = Rig(target="corner", sweeps=8).scans()
    solved = solve_sweeps(scans, KINDS[1], Mounting(T_FLANGE_SCANNER), Asked())
    skin = corner_skin(PlanesTarget(CORNER, CORNER @ CENTRE, np.zeros(0, dtype=np.int64)), ROBOT)
    skin = replace(skin, steepest=0.05)  # the rig's scanner sees grazed faces too
    mounting = Mounting(T_FLANGE_SCANNER)
    made = [
        foreseen(
            Sweep(scan.T_base_flange[0], scan.T_base_flange[-1], scan.profiles[-1].time_s), skin, mounting, Asked()
        )
        for scan in scans
    ]
    foretold = covariance_after(made, Expected(shift_m=0.0))
    for stated, expected in zip(spread(solved.hand_eye.covariance[:6, :6]), spread(foretold), strict=True):
        assert 0.4 < expected / stated < 2.5


def test_a_corner_is_three_squares_before_their_common_tip_that_look_at_the_robot() -> None:
    corner = expected_corner(TARGET)
    turned = PlanesTarget(corner.normals * [[1.0], [-1.0], [1.0]], corner.offsets * [1.0, -1.0, 1.0], corner.plane)
    for target in (corner, turned):  # a plane found in a sweep may look to either side
        skin = corner_skin(target, ROBOT)
        tip = TARGET.apply(np.array([[0.0, 0.0, 0.02]]))[0]
        sides = (skin.points - tip) @ corner.normals.T
        assert np.abs(sides.max(axis=1)).max() < 1e-9  # on one face and behind the others
        assert np.linalg.norm(skin.points - tip, axis=1).max() < np.sqrt(2.0) * FACE_M
        assert (np.einsum("ni,ni->n", skin.normals, ROBOT - skin.points) > 0).all()
        assert skin.area_m2.sum() == pytest.approx(3 * FACE_M**2)


def test_more_sweeps_foretell_less_uncertainty_and_one_foretells_what_was_known_before() -> None:
    views = [told(view) for view in candidates(16)]
    assert spread(covariance_after(views, Expected()))[0] < 0.7 * spread(covariance_after(views[:6], Expected()))[0]
    assert spread(covariance_after(views[:1], Expected()))[0] == pytest.approx(0.03, abs=0.02)


def test_a_sweep_that_brings_the_plug_near_the_target_is_not_proposed() -> None:
    def planned(nearer_mm: float):
        return sweep_of(View(nearer_mm=nearer_mm), TARGET, CONFIG.scan, MOUNTING.T_flange_scanner.inverse() @ TCP)

    assert reachable(planned(0.0), TARGET, lambda _: None) is None
    assert f"{1e3 * CLEAR_M:.0f} mm" in str(reachable(planned(100.0), TARGET, lambda _: None))
    assert reachable(planned(0.0), TARGET, lambda _: "out of reach") == "out of reach"


@pytest.mark.parametrize(
    ("target", "ideal", "estimated"),
    [("sphere", False, True), ("planes", False, True), ("port", False, False), ("sphere", True, False)],
)
def test_the_arm_is_estimated_from_true_shapes_unless_it_is_taken_at_its_word(
    target: Literal["sphere", "planes", "port"], ideal: bool, estimated: bool
) -> None:
    assert Wanted(TargetKind(target), ideal_arm=ideal).estimates_arm is estimated
