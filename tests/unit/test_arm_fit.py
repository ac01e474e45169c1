"""The arm's own errors estimated with the mounting: better than without, honest, and refused where no arm is so bad."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from perception.calibration.arm_errors import COUNT
from perception.calibration.arm_fit import SHIFT_M, fit_arm, prior_sigma
from perception.calibration.errors import CalibrationError
from perception.calibration.from_sweeps import Solved, TargetKind, solve_sweeps
from perception.calibration.hand_eye import Asked
from perception.calibration.sightings import Mounting
from perception.evaluation.calibration_cells import Chain, TrueCell, draw_cell, with_all_errors
from perception.evaluation.calibration_controller import (
    CENTRE,
    SWEEPS,
    Known,
    calibrated_with_arm,
    error_jacobian_at,
    pose_error,
)
from perception.evaluation.calibration_trials import located
from perception.geometry import Pose
from perception.scan import Scan
from tests.unit.calibration_rig import T_FLANGE_SCANNER, Rig

HOME = Pose(np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), CENTRE)


def erring(seed: int) -> TrueCell:
    rng = np.random.default_rng([seed, 7])
    return with_all_errors(draw_cell(rng, joint_rad=3.5e-4, link_m=2e-4), rng)


@pytest.fixture(scope="module")
def known() -> list[tuple[TrueCell, Known]]:
    """Six cells as their controllers know them."""
    return [(cell := erring(seed), calibrated_with_arm(cell, np.random.default_rng(seed))) for seed in range(6)]


def located_mm(cell: TrueCell, controller: Known) -> float:
    seen = located(cell, HOME, controller, np.zeros(3), np.random.default_rng(0))
    return 1e3 * seen.distance_to(HOME)


def test_a_port_is_located_better_than_with_the_arm_at_its_word(known: list[tuple[TrueCell, Known]]) -> None:
    ours = np.array([located_mm(cell, controller) for cell, controller in known])
    ideal = np.array([located_mm(cell, controller.ideal) for cell, controller in known])
    assert np.median(ours) < 0.5
    assert np.median(ours) < 0.75 * np.median(ideal)


def test_what_is_stated_covers_what_is_true(known: list[tuple[TrueCell, Known]]) -> None:
    """Six cells: a chi square of six degrees of freedom each, 99.9 % in all."""
    squares: float = 0.0
    for cell, controller in known:
        assert controller.fit is not None
        off = pose_error(cell.T_flange_scanner, controller.mounting.T_flange_scanner)
        squares += float(off @ np.linalg.solve(controller.fit.covariance[:6, :6], off))
        assert located_mm(cell, controller) < 3.0e3 * controller.located_sigma_m(HOME)
    assert squares < 67.98


def test_what_one_target_cannot_tell_stays_as_uncertain_as_before(known: list[tuple[TrueCell, Known]]) -> None:
    """The first joint's zero turns the whole cell about the base's axis."""
    fit = known[0][1].fit
    assert fit is not None
    left = np.sqrt(np.diag(fit.covariance)[6:]) / prior_sigma()
    assert left.max() < 1.0 + 1e-6
    assert left[12] == pytest.approx(1.0, abs=0.01)
    assert left[18] < 0.9  # how far the arm gives does show


def swept(cell: TrueCell, seed: int) -> tuple[list[Scan], Solved, list[np.ndarray]]:
    scans = cell.sphere_sweeps(CENTRE, SWEEPS, np.random.default_rng(seed))
    solved = solve_sweeps(scans, TargetKind("sphere"), Mounting(cell.T_flange_scanner), Asked())
    return scans, solved, [np.stack([error_jacobian_at(scan.T_base_flange[k]) for k in (0, -1)]) for scan in scans]


def test_a_perfect_arm_is_found_nearly_perfect() -> None:
    cell = draw_cell(np.random.default_rng(1))
    _, solved, by_arm = swept(cell, 1)
    fit = fit_arm(solved.seen, solved.hand_eye, by_arm, Asked())
    assert np.abs(fit.errors / prior_sigma()).max() < 1.0
    assert fit.hand_eye.mounting.T_flange_scanner.distance_to(cell.T_flange_scanner) < 3e-4
    assert fit.shift_m == pytest.approx(SHIFT_M, rel=0.5)


def test_the_faces_of_a_corner_serve_as_well_as_a_sphere() -> None:
    scans = Rig(target="corner", sweeps=8).scans()
    solved = solve_sweeps(scans, TargetKind("planes"), Mounting(T_FLANGE_SCANNER), Asked())
    by_arm = [np.stack([error_jacobian_at(scan.T_base_flange[k]) for k in (0, -1)]) for scan in scans]
    fit = fit_arm(solved.seen, solved.hand_eye, by_arm, Asked())
    assert np.abs(fit.errors / prior_sigma()).max() < 1.0
    assert fit.hand_eye.mounting.T_flange_scanner.distance_to(T_FLANGE_SCANNER) < 1e-4


def test_sweeps_that_are_displaced_by_more_than_the_arms_errors_show_it() -> None:
    cell = draw_cell(np.random.default_rng(1))
    scans, _, by_arm = swept(cell, 1)
    rng = np.random.default_rng(2)
    shaken = []
    for scan in scans:
        off = rng.normal(0, 2e-4, 3)
        poses = tuple(Pose(pose.rotation, pose.translation + off) for pose in scan.T_base_flange)
        shaken.append(replace(scan, T_base_flange=poses))
    solved = solve_sweeps(shaken, TargetKind("sphere"), Mounting(cell.T_flange_scanner), Asked())
    fit = fit_arm(solved.seen, solved.hand_eye, by_arm, Asked())
    assert 1e-4 < fit.shift_m < 4e-4


def test_an_arm_that_is_off_by_more_than_any_arm_is_refused() -> None:
    nominal = Chain.nominal()
    bent = nominal.rows.copy()
    bent[3, 3] += np.deg2rad(0.5)
    cell = replace(draw_cell(np.random.default_rng(3)), arm=Chain(bent))
    _, solved, by_arm = swept(cell, 3)
    with pytest.raises(CalibrationError, match="times what arms are") as refused:
        fit_arm(solved.seen, solved.hand_eye, by_arm, Asked())
    assert "--ideal-arm" in refused.value.remedy


def test_only_what_was_asked_for_is_uncertain() -> None:
    cell = draw_cell(np.random.default_rng(4))
    _, solved, by_arm = swept(cell, 4)
    fit = fit_arm(solved.seen, solved.hand_eye, by_arm, Asked(time_offset=False))
    assert fit.covariance.shape == (6 + COUNT, 6 + COUNT)
    assert fit.hand_eye.covariance[6:].any() == np.False_
    assert fit.hand_eye.mounting.time_offset_s == solved.hand_eye.mounting.time_offset_s
