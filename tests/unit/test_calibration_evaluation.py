"""The simulation behind ``evaluate calibration``: its arm is the real one's, its poses close; and OpenCV as an oracle."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.arm.kinematics import MODELS, forward
from perception.evaluation.calibration_cells import START, Chain, TrueCell, draw_cell
from perception.evaluation.calibration_report import rows, table
from perception.evaluation.calibration_trials import (
    T_FLANGE_TCP,
    T_PORT_TCP,
    DriftTrial,
    HandEyeTrial,
    PlacingTrial,
    drift_trial,
    told_when_mated,
)
from perception.geometry import Pose, exp


def test_the_nominal_chain_is_the_arm_that_the_driver_knows() -> None:
    for joints in np.random.default_rng(0).uniform(-2, 2, (5, 6)):
        ours, theirs = Chain.nominal().flange(joints), forward(MODELS["ur10e"], joints)
        np.testing.assert_allclose(ours.matrix, theirs.matrix, atol=1e-12)


def test_a_mated_plug_is_told_where_the_erring_arm_believes_it_is() -> None:
    rng = np.random.default_rng(1)
    cell = draw_cell(rng, joint_rad=3e-4, link_m=2e-4)
    T_base_port = Pose(np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.9, 0.1, 0.45]))
    told = told_when_mated(cell, T_base_port, rng)
    true = cell.true_flange(told @ T_FLANGE_TCP.inverse()) @ cell.T_flange_tcp
    assert true.distance_to(T_base_port @ T_PORT_TCP) < 0.0003  # how a plug sits
    assert told.distance_to(T_base_port @ T_PORT_TCP) > 0.0003  # errors of arm and tool


def test_a_perfect_arm_is_where_it_says() -> None:
    perfect = TrueCell(Chain.nominal(), Pose.identity(), Pose.identity())
    pose = Chain.nominal().flange(START + 0.1)
    assert perfect.true_flange(pose).distance_to(pose) < 1e-6


def test_the_drift_trial_sees_a_bump() -> None:
    found = [drift_trial(seed) for seed in range(10)]
    assert sum(trial.docks_to_warning is not None and trial.docks_to_warning <= 8 for trial in found) >= 9


def test_the_table_says_no_where_a_bar_is_missed() -> None:
    good, bad = HandEyeTrial(0.05, 0.01, True), HandEyeTrial(0.5, 0.2, False)
    placed = PlacingTrial(0.2, 0.8, 0.2)
    text = table(rows(20, [good] * 19 + [good], [placed] * 5, [DriftTrial(False, 3)] * 5), 20)
    assert "| hand-eye position, perfect arm, 95% quantile of 20 | 0.050 mm |" in text
    missed = rows(20, [bad] * 20, [placed] * 5, [DriftTrial(True, None)] * 5)
    assert [row.met for row in missed[1:4]] == [False, False, False]
    assert not missed[-1].met


def test_poses_of_a_board_give_opencv_the_same_mounting() -> None:
    """The closed form (Tsai and Lenz 1989, in OpenCV) on noise-free board poses, against the frames of our solution."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV, the oracle of hand-eye calibration, is not installed")
    rng = np.random.default_rng(2)
    T_flange_scanner = Pose.from_rotvec([0.05, -0.03, 0.1], [0.0, -0.09, 0.04])
    T_base_board = Pose.from_rotvec([0.3, 0.2, -0.1], [0.9, 0.1, 0.5])
    flanges = [Chain.nominal().flange(START + rng.uniform(-0.4, 0.4, 6)) for _ in range(10)]
    boards = [(flange @ T_flange_scanner).inverse() @ T_base_board @ exp(np.zeros(6)) for flange in flanges]
    rotation, translation = cv2.calibrateHandEye(
        [f.rotation for f in flanges],
        [f.translation for f in flanges],
        [b.rotation for b in boards],
        [b.translation for b in boards],
    )
    np.testing.assert_allclose(rotation, T_flange_scanner.rotation, atol=1e-6)
    np.testing.assert_allclose(translation.ravel(), T_flange_scanner.translation, atol=1e-6)
