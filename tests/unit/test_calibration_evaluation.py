"""The simulation behind ``evaluate calibration``: its arm is the real one's, its poses close; OpenCV as an oracle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.port_files import load_port
from drivers.arm.kinematics import MODELS, forward
from perception.calibration.from_sweeps import TargetKind, solve_sweeps
from perception.calibration.hand_eye import Asked
from perception.calibration.sightings import Mounting
from perception.evaluation.calibration_cells import FACING_X, START, Chain, TrueCell, draw_cell
from perception.evaluation.calibration_controller import T_FLANGE_TCP, T_PORT_TCP, calibrated_with_arm
from perception.evaluation.calibration_report import Trials, rows, table
from perception.evaluation.calibration_trials import (
    CAPTURE_M,
    CAPTURE_RAD,
    CAR_M,
    CAR_RAD,
    DriftTrial,
    HandEyeTrial,
    Placed,
    PlacingTrial,
    drift_trial,
    plug_placed,
    told_when_mated,
)
from perception.geometry import Pose
from tests.unit.calibration_rig import CORNER, T_FLANGE_SCANNER, Rig


def home() -> Pose:
    """A port that looks at the robot."""
    return Pose(np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.9, 0.1, 0.45]))


def test_the_nominal_chain_is_the_arm_that_the_driver_knows() -> None:
    for joints in np.random.default_rng(0).uniform(-2, 2, (5, 6)):
        ours, theirs = Chain.nominal().flange(joints), forward(MODELS["ur10e"], joints)
        np.testing.assert_allclose(ours.matrix, theirs.matrix, atol=1e-12)


def test_a_mated_plug_is_told_where_the_erring_arm_believes_it_is() -> None:
    rng = np.random.default_rng(1)
    cell = draw_cell(rng, joint_rad=3e-4, link_m=2e-4)
    T_base_port = home()
    told = told_when_mated(cell, T_base_port, rng)
    true = cell.true_flange(told @ T_FLANGE_TCP.inverse()) @ cell.T_flange_tcp
    assert true.distance_to(T_base_port @ T_PORT_TCP) < 0.0003  # how a plug sits
    assert told.distance_to(T_base_port @ T_PORT_TCP) > 0.0003  # errors of arm and tool


def test_a_perfect_arm_is_where_it_says() -> None:
    perfect = TrueCell(Chain.nominal(), Pose.identity(), Pose.identity())
    pose = Chain.nominal().flange(START + 0.1)
    assert perfect.true_flange(pose).distance_to(pose) < 1e-6


def test_an_arm_that_hangs_is_lower_than_it_says_and_the_more_so_the_farther_it_reaches() -> None:
    hanging = TrueCell(Chain.nominal(), Pose.identity(), Pose.identity(), compliance_rad_per_nm=3e-6)
    near, far = (Pose(FACING_X, np.array([x, 0.1, 0.45])) for x in (0.6, 0.9))
    sags = [pose.translation - hanging.true_flange(pose).translation for pose in (near, far)]
    assert 0.0001 < sags[0][2] < sags[1][2] < 0.0008
    assert np.abs(np.array(sags)[:, :2]).max() < 0.0003


def test_gravity_turns_no_joint_whose_axis_is_upright_and_the_shoulder_by_weight_times_lever() -> None:
    stretched = np.zeros(6)  # along the base's -x
    torques = Chain.nominal().torques(stretched)
    assert torques[0] == pytest.approx(0.0, abs=1e-9)
    levers_m = [0.0, 0.6127 / 2, 0.6127 + 0.57155 / 2, 0.6127 + 0.57155, 0.6127 + 0.57155, 0.6127 + 0.57155]
    expected = 9.81 * (np.array([13.1, 4.0, 2.1, 2.0, 0.6, 3.0]) @ [*levers_m[1:], 0.6127 + 0.57155])
    assert abs(torques[1]) == pytest.approx(expected, rel=1e-3)


def test_a_clock_that_is_off_is_estimated_with_the_mounting() -> None:
    cell = replace(draw_cell(np.random.default_rng(2)), time_offset_s=0.004)
    assert calibrated_with_arm(cell, np.random.default_rng(3)).mounting.time_offset_s == pytest.approx(0.004, abs=3e-4)


def test_the_drift_trial_sees_a_bump() -> None:
    found = [drift_trial(seed) for seed in range(10)]
    assert sum(trial.docks_to_warning is not None and trial.docks_to_warning <= 8 for trial in found) >= 9


def test_the_table_says_no_where_a_bar_is_missed() -> None:
    good, bad = HandEyeTrial(0.05, 0.01, True, 0.1), HandEyeTrial(0.5, 0.2, False, 0.5)
    placed = PlacingTrial(0.2, 0.3, 0.5, True, Placed(0.8, True), Placed(0.2, True))
    text = table(rows(20, Trials([good] * 20, [placed] * 5, [placed] * 5, [DriftTrial(False, 3)] * 5)), 20)
    assert "| hand-eye position, perfect arm, 95% quantile of 20 | 0.050 mm |" in text
    missed = rows(20, Trials([bad] * 20, [placed] * 5, [placed] * 5, [DriftTrial(True, None)] * 5))
    assert [row.met for row in missed[1:4]] == [False, False, False]
    assert not missed[-1].met


def test_a_plug_beyond_capture_is_no_first_try_and_two_of_a_hundred_are_too_many() -> None:
    good, astray = Placed(0.2, True), Placed(1.2, False)
    tries = [PlacingTrial(0.2, 0.3, 0.5, True, astray, good)] * 98 + [
        PlacingTrial(0.2, 0.3, 0.5, True, astray, astray)
    ] * 2
    found = {row.what: row for row in rows(20, Trials([HandEyeTrial(0.05, 0.01, True, 0.1)], [], tries, []))}
    after, without = (f"first tries within capture {when} teaching, all errors" for when in ("after", "without"))
    taught, untaught = found[after], found[without]
    assert (taught.value, taught.met, untaught.value, untaught.bar) == ("98/100", False, "0/100", "reported")


@pytest.mark.parametrize(
    ("off_mm", "turn_deg", "captured"),
    [((0.9, 0, 0), 0.0, True), ((0.8, 0.7, 0), 0.0, False), ((0, 0, 5), 0.9, True), ((0, 0, 0), 1.1, False)],
)
def test_capture_is_judged_sideways_and_by_angle_as_the_port_file_says(
    off_mm: tuple[float, ...], turn_deg: float, captured: bool
) -> None:
    port = load_port("ccs2")
    assert (port.capture_radius_m, port.capture_tilt_rad) == pytest.approx((CAPTURE_M, CAPTURE_RAD))
    cell = TrueCell(Chain.nominal(), Pose.identity(), T_FLANGE_TCP)
    T_base_port = home()
    off = Pose.from_rotvec(np.deg2rad([turn_deg, 0.0, 0.0]), np.array(off_mm) / 1e3)
    found = plug_placed(cell, T_base_port, T_base_port @ T_PORT_TCP @ off)
    assert found.captured is captured
    assert found.off_mm == pytest.approx(np.linalg.norm(off_mm), abs=1e-3)


def test_scanning_and_docking_are_on_one_branch_of_the_arm_at_every_car() -> None:
    """A joint that jumps between the two would meet other errors of the arm at the dock than at the scan."""
    rng = np.random.default_rng(4)
    for _ in range(12):
        T_base_port = home().moved(rng.uniform(-CAR_M, CAR_M, 3)) @ Pose.from_rotvec(rng.uniform(-CAR_RAD, CAR_RAD, 3))
        at_scan = T_base_port @ Pose(T_PORT_TCP.rotation, np.array([0.0, 0.0, 0.29])) @ T_FLANGE_SCANNER.inverse()
        at_dock = T_base_port @ T_PORT_TCP @ T_FLANGE_TCP.inverse()
        scan, dock = (Chain.nominal().joints_for(pose, START) for pose in (at_scan, at_dock))
        assert np.abs(scan - dock).max() < 0.8


def test_opencvs_closed_form_finds_the_mounting_that_our_solver_finds() -> None:
    """Sweeps of a corner: ours from all points, OpenCV's from the corner's pose in each sweep's own cloud.

    The closed form weighs every pose alike: eight noisy ones leave it some tenths of a millimetre off.
    """
    cv2 = pytest.importorskip("cv2", reason="OpenCV, the oracle of hand-eye calibration, is not installed")
    if not hasattr(cv2, "calibrateHandEye"):
        pytest.skip("this OpenCV has no calibrateHandEye: install opencv-python-headless below 5")
    scans = Rig(target="corner", sweeps=8).scans()
    guess = Mounting(T_FLANGE_SCANNER @ Pose.from_rotvec(np.deg2rad([6.0, -6.0, 5.2]), [0.011, -0.012, 0.011]))
    ours = solve_sweeps(scans, TargetKind("planes"), guess, Asked())
    target, points = ours.hand_eye.target, ours.seen.in_base(ours.hand_eye.mounting)
    flanges, corners = [], []
    for number, scan in enumerate(scans):
        middle = scan.T_base_flange[len(scan.T_base_flange) // 2]
        own = ours.seen.sweep_of_point == number
        T_base_corner = corner_pose(points[own], target.plane[own])
        flanges.append(middle)
        corners.append((middle @ ours.hand_eye.mounting.T_flange_scanner).inverse() @ T_base_corner)
    rotation, translation = cv2.calibrateHandEye(
        [f.rotation for f in flanges],
        [f.translation for f in flanges],
        [c.rotation for c in corners],
        [c.translation for c in corners],
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    oracle = Pose(np.asarray(rotation), np.asarray(translation).ravel())
    assert oracle.distance_to(ours.hand_eye.mounting.T_flange_scanner) < 0.0006
    assert np.rad2deg(oracle.angle_to(ours.hand_eye.mounting.T_flange_scanner)) < 0.15


def corner_pose(points: np.ndarray, plane: np.ndarray) -> Pose:
    """Where three planes meet, turned as their normals are."""
    normals, offsets = [], []
    for k in range(3):
        own = points[plane == k]
        normal = np.linalg.svd(own - own.mean(axis=0), full_matrices=False)[2][2]
        normal *= np.sign(normal @ CORNER[np.abs(CORNER @ normal).argmax()])
        normals.append(normal)
        offsets.append(normal @ own.mean(axis=0))
    u, _, vt = np.linalg.svd(np.array(normals))
    return Pose((u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T, np.linalg.solve(normals, offsets))
