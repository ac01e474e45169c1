"""Teaching and tool calibration: what is computed, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from perception.calibration.errors import CalibrationError
from perception.calibration.teaching import teach
from perception.calibration.tool import tool_point
from perception.geometry import Pose, exp

T_BASE_PORT = Pose.from_rotvec([1.2, -1.2, -1.2], [0.95, 0.1, 0.45])
T_PORT_TCP = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.03]))
TOOL = np.array([0.01, -0.02, 0.2])


def touches(count: int, rng: np.random.Generator, noise_m: float = 0.0, turn: float = 1.0) -> list[Pose]:
    point = np.array([0.6, 0.1, 0.3])
    rotations = Rotation.from_rotvec(turn * rng.uniform(-0.7, 0.7, (count, 3))).as_matrix()
    return [Pose(r, point - r @ TOOL + rng.normal(0, noise_m, 3)) for r in rotations]


def test_taught_pose_cancels_a_constant_error_of_the_located_port() -> None:
    constant = exp([0.0007, -0.0004, 0.0003, 0.004, -0.002, 0.003])
    mated = T_BASE_PORT @ T_PORT_TCP
    taught = teach([T_BASE_PORT @ constant] * 3, mated)
    other_car = T_BASE_PORT @ exp([0.05, 0.03, 0.02, 0.05, 0.02, -0.05])
    placed = other_car @ constant @ taught.T_port_tcp
    assert placed.distance_to(other_car @ T_PORT_TCP) < 1e-9


def test_spread_of_the_scans_is_told_and_too_much_of_it_refused() -> None:
    scans = [T_BASE_PORT @ exp([x, 0, 0, 0, 0, 0]) for x in (-1e-4, 0.0, 1e-4)]
    taught = teach(scans, T_BASE_PORT @ T_PORT_TCP)
    assert taught.spread_m == pytest.approx(1e-4, rel=0.01)
    assert np.sqrt(taught.covariance[0, 0]) == pytest.approx(1e-4 / np.sqrt(3), rel=0.01)
    apart = [T_BASE_PORT @ exp([x, 0, 0, 0, 0, 0]) for x in (-4e-4, 0.0, 4e-4)]
    with pytest.raises(CalibrationError, match=r"disagree by 0\.40 mm"):
        teach(apart, T_BASE_PORT @ T_PORT_TCP)
    turned = [T_BASE_PORT @ exp([0, 0, 0, 0, 0, r]) for r in (-0.005, 0.0, 0.005)]
    with pytest.raises(CalibrationError, match=r"0\.29 deg"):
        teach(turned, T_BASE_PORT @ T_PORT_TCP)


def test_two_scans_do_not_teach() -> None:
    with pytest.raises(CalibrationError, match="too few"):
        teach([T_BASE_PORT] * 2, T_BASE_PORT)


def test_touching_a_point_finds_the_tool_and_how_sure_that_is() -> None:
    rng = np.random.default_rng(0)
    errors, sigmas = [], []
    for _ in range(50):
        found = tool_point(touches(8, rng, noise_m=1e-4))
        errors.append(found.in_flange - TOOL)
        sigmas.append(np.sqrt(np.diag(found.covariance)))
    assert np.abs(errors).max() < 6e-4
    assert np.std(errors) == pytest.approx(np.mean(sigmas), rel=0.35)


def test_touches_with_one_orientation_are_refused() -> None:
    with pytest.raises(CalibrationError, match="alike"):
        tool_point(touches(8, np.random.default_rng(0), turn=0.01))


def test_a_touch_of_another_point_is_named() -> None:
    poses = touches(8, np.random.default_rng(0))
    poses[4] = Pose(poses[4].rotation, poses[4].translation + np.array([0.0, 0.006, 0.0]))
    with pytest.raises(CalibrationError, match="touch 5"):
        tool_point(poses)


def test_too_few_touches_are_refused() -> None:
    with pytest.raises(CalibrationError, match="3 touches"):
        tool_point(touches(3, np.random.default_rng(0)))
