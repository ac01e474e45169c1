"""Hand-eye calibration from sweeps of a sphere and of a corner: accuracy, honesty, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from perception.calibration.checks import left_out_errors_m, refuse_moved, refuse_other_size
from perception.calibration.errors import CalibrationError
from perception.calibration.find_planes import COARSE_SCALE_M, find_planes
from perception.calibration.find_sphere import find_sphere
from perception.calibration.hand_eye import Asked, HandEye, mounting_jacobian, solve
from perception.calibration.sightings import Mounting, Sightings, sightings
from perception.calibration.targets import SphereTarget
from perception.geometry import Pose
from tests.unit.calibration_rig import CENTRE, RADIUS_M, T_FLANGE_SCANNER, Rig

FAR_GUESS = T_FLANGE_SCANNER @ Pose.from_rotvec(np.deg2rad([6.0, -6.0, 5.2]), [0.011, -0.012, 0.011])
"""20 mm and 10 deg off."""


def by_sphere(rig: Rig, asked: Asked, guess: Pose = FAR_GUESS) -> tuple[Sightings, HandEye]:
    seen = sightings(rig.scans(), max_points=2500)
    found = find_sphere(seen, RADIUS_M, Mounting(guess))
    seen = seen.of(found.on_sphere)
    return seen, solve(seen, found.target, found.mounting, asked)


def error(solved: HandEye, time_offset_s: float = 0.0) -> np.ndarray:
    found = solved.mounting.T_flange_scanner
    turn = Rotation.from_matrix(T_FLANGE_SCANNER.rotation.T @ found.rotation).as_rotvec()
    return np.concatenate(
        [found.translation - T_FLANGE_SCANNER.translation, turn, [solved.mounting.time_offset_s - time_offset_s]]
    )


def test_the_guess_of_these_tests_is_20_mm_and_10_deg_off() -> None:
    assert FAR_GUESS.distance_to(T_FLANGE_SCANNER) == pytest.approx(0.020, abs=0.001)
    assert np.rad2deg(FAR_GUESS.angle_to(T_FLANGE_SCANNER)) == pytest.approx(10.0, abs=0.3)


def test_a_sphere_gives_mounting_and_time_offset_from_a_far_guess() -> None:
    _, solved = by_sphere(Rig(time_offset_s=0.004), Asked(time_offset=True))
    off = error(solved, 0.004)
    assert np.linalg.norm(off[:3]) < 0.00015
    assert np.rad2deg(np.linalg.norm(off[3:6])) < 0.05
    assert abs(off[6]) < 0.0005
    assert off @ np.linalg.solve(solved.covariance[:7, :7], off) < 24.3  # chi2, 7 degrees of freedom, 99.9 %


def test_sweeps_that_show_two_faces_of_a_corner_are_left_out_until_too_few_others_are_left() -> None:
    seen = sightings(Rig(target="corner", sweeps=6).scans(), max_points=1500)
    whole = find_planes(seen, Mounting(T_FLANGE_SCANNER), np.random.default_rng(0))
    plane, owner = whole.target.plane, seen.sweep_of_point[whole.on_planes]
    assert set(owner) == set(range(6))
    points = seen.of(whole.on_planes)
    lacking = points.of(~((plane == 0) & (owner < 2)))
    found = find_planes(lacking, Mounting(T_FLANGE_SCANNER), np.random.default_rng(0))
    assert set(lacking.sweep_of_point[found.on_planes]) == {2, 3, 4, 5}
    with pytest.raises(CalibrationError, match="sweep 1 shows only 2 planes"):
        find_planes(points.of(~((plane == 0) & (owner < 3))), Mounting(T_FLANGE_SCANNER), np.random.default_rng(0))


def test_noise_free_sweeps_give_the_mounting_exactly() -> None:
    _, solved = by_sphere(Rig(noise_m=0.0, time_offset_s=-0.01), Asked())
    assert np.abs(error(solved, -0.01)).max() < 1e-6


def test_a_corner_of_three_planes_gives_the_mounting_from_a_far_guess() -> None:
    seen = sightings(Rig(target="corner").scans(), max_points=3000)
    found = find_planes(seen, Mounting(FAR_GUESS), np.random.default_rng(0))
    seen = seen.of(found.on_planes)
    solved = solve(seen, found.target, Mounting(FAR_GUESS), Asked(), start_scale_m=COARSE_SCALE_M)
    off = error(solved)
    assert np.linalg.norm(off[:3]) < 0.00015
    assert np.rad2deg(np.linalg.norm(off[3:6])) < 0.05


def test_a_sweep_longer_than_the_arm_says_shows_as_speed_scale() -> None:
    _, solved = by_sphere(Rig(speed_scale=1.02), Asked(time_offset=True, speed_scale=True), T_FLANGE_SCANNER)
    assert solved.mounting.speed_scale == pytest.approx(1.02, abs=0.002)


def test_errors_of_the_arm_make_the_covariance_larger_not_only_the_error() -> None:
    _, still = by_sphere(Rig(), Asked())
    _, shaky = by_sphere(Rig(arm_error_m=0.0003), Asked())
    assert np.trace(shaky.covariance[:3, :3]) > 4 * np.trace(still.covariance[:3, :3])
    off = error(shaky)[:6]
    assert off @ np.linalg.solve(shaky.covariance[:6, :6], off) < 22.5  # chi2, 6 degrees of freedom, 99.9 %


def test_the_jacobian_is_the_derivative_of_the_distances() -> None:
    seen = sightings(Rig(sweeps=4, time_offset_s=0.01).scans(), max_points=50)
    target, at = SphereTarget(CENTRE, RADIUS_M), Mounting(T_FLANGE_SCANNER, 0.01, 1.1)
    jacobian = mounting_jacobian(seen, at, target.distances(seen.in_base(at)))
    step = 1e-6
    moved = [
        Mounting(Pose(T_FLANGE_SCANNER.rotation, T_FLANGE_SCANNER.translation + step * np.eye(3)[k]), 0.01, 1.1)
        for k in range(3)
    ]
    moved += [Mounting(T_FLANGE_SCANNER @ Pose.from_rotvec(step * np.eye(3)[k]), 0.01, 1.1) for k in range(3)]
    moved += [Mounting(T_FLANGE_SCANNER, 0.01 + step, 1.1), Mounting(T_FLANGE_SCANNER, 0.01, 1.1 + step)]
    here = target.distances(seen.in_base(at)).residual
    numeric = np.stack([(target.distances(seen.in_base(one)).residual - here) / step for one in moved], axis=1)
    np.testing.assert_allclose(jacobian, numeric, atol=2e-4)


def test_sweeps_of_one_orientation_are_refused_and_the_missing_motion_named() -> None:
    rig = Rig(tilts=False)
    seen = sightings(rig.scans(), max_points=2500)
    found = find_sphere(seen, RADIUS_M, Mounting(T_FLANGE_SCANNER))
    with pytest.raises(CalibrationError, match="do not determine") as caught:
        solve(seen.of(found.on_sphere), found.target, found.mounting, Asked())
    assert "sweep" in caught.value.remedy


def test_a_sphere_of_another_size_is_refused_with_its_measured_diameter() -> None:
    seen, solved = by_sphere(Rig(radius_m=RADIUS_M + 0.001), Asked())
    with pytest.raises(CalibrationError, match=r"diameter is 52\.\d\d mm, not 50\.80 mm"):
        refuse_other_size(seen, solved, Asked())
    seen, solved = by_sphere(Rig(), Asked())
    refuse_other_size(seen, solved, Asked())


def test_a_target_that_moved_before_the_last_sweep_is_refused() -> None:
    seen, solved = by_sphere(Rig(moved_in_last_m=0.004), Asked())
    with pytest.raises(CalibrationError, match="sweep 8 shows the target"):
        refuse_moved(left_out_errors_m(seen, solved, Asked()))


def test_a_target_that_stood_still_is_foretold_by_the_other_sweeps() -> None:
    seen, solved = by_sphere(Rig(), Asked())
    errors_m = left_out_errors_m(seen, solved, Asked())
    assert errors_m.max() < 0.0005
    refuse_moved(errors_m)


def test_too_few_sweeps_are_refused() -> None:
    seen, solved = by_sphere(Rig(), Asked())
    few = seen.of(seen.sweep_of_point < 3)
    with pytest.raises(CalibrationError, match="3 sweeps are too few"):
        left_out_errors_m(few, solved, Asked())


def test_a_sphere_half_hidden_is_refused() -> None:
    with pytest.raises(CalibrationError, match="only a part of the sphere"):
        by_sphere(Rig(hidden_beyond_m=0.0), Asked(), T_FLANGE_SCANNER)


def test_a_scene_without_a_sphere_is_refused() -> None:
    with pytest.raises(CalibrationError, match="sphere"):
        by_sphere(Rig(target="corner"), Asked(), T_FLANGE_SCANNER)


def test_a_scene_without_a_corner_is_refused() -> None:
    seen = sightings(Rig().scans())
    with pytest.raises(CalibrationError, match="planes"):
        find_planes(seen, Mounting(T_FLANGE_SCANNER), np.random.default_rng(0))
