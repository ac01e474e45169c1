"""The tool from a mated plug: exact without errors, honest with them, and refused when the looks say nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from perception.calibration.errors import CalibrationError
from perception.calibration.mated_tool import Known, Look, MatedDock, tool_by_mating
from perception.geometry import Array, Pose, exp

T_BASE_PORT = Pose.from_rotvec([1.2092, -1.2092, -1.2092], [0.95, 0.1, 0.45])
T_PORT_TCP = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.049]))
TOOL = Pose.from_rotvec([0.01, -0.02, 0.03], [0.001, -0.002, 0.2])
SCANNER = Pose.from_rotvec([0.02, 0.01, -0.03], [0.0, -0.09, 0.04])
SIGMA = np.array([3e-4] * 3 + [4e-4] * 3)
KNOWN = Known(T_PORT_TCP, SCANNER, np.diag(SIGMA**2), TOOL, length_sigma_m=2e-4, play_m=2e-4, play_rad=5e-3)
SIDES = ((0.0, 0.0), (0.2, 0.0), (0.0, 0.2))


def flange_looking(pitch: float, yaw: float) -> Pose:
    """Where the flange is while the true scanner looks at the port from 0.29 m."""
    facing = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.29]))
    return T_BASE_PORT @ Pose.from_rotvec([pitch, yaw, 0.0]) @ facing @ SCANNER.inverse()


def dock(
    hand_eye_error: Array | None = None, play: Array | None = None, sides: tuple[tuple[float, float], ...] = SIDES
) -> MatedDock:
    """``hand_eye_error`` (6,) of the scanner that is believed in, as its covariance counts it; ``play`` (6,) of the
    plug in the port."""
    error = np.zeros(6) if hand_eye_error is None else hand_eye_error
    turned = SCANNER @ exp([0.0, 0.0, 0.0, *error[3:]])
    believed = Pose(turned.rotation, turned.translation + error[:3])
    sits = T_PORT_TCP @ exp(np.zeros(6) if play is None else play)

    def look(pitch: float, yaw: float) -> Look:
        flange = flange_looking(pitch, yaw)
        return Look(flange, flange @ believed @ (flange @ SCANNER).inverse() @ T_BASE_PORT)

    looks = tuple(look(*side) for side in sides)
    return MatedDock(T_BASE_PORT @ sits @ TOOL.inverse(), looks[0].T_base_port, looks)


def error_of(tool: Pose) -> Array:
    return np.concatenate([tool.translation - TOOL.translation, (TOOL.inverse() @ tool).rotvec])


def test_docks_without_errors_give_the_tool_exactly() -> None:
    elsewhere = replace(KNOWN, T_flange_tcp=TOOL @ exp([0.003, -0.002, 0.0, 0.02, 0.01, 0.03]))
    found = tool_by_mating([dock(), dock()], elsewhere)
    off = error_of(found.T_flange_tcp)
    across = off[:3] - TOOL.rotation[:, 2] * (TOOL.rotation[:, 2] @ off[:3])
    assert np.abs(across).max() < 1e-12
    assert np.abs(off[3:]).max() < 1e-9


def test_the_error_is_as_large_as_the_covariance_says() -> None:
    rng, squares = np.random.default_rng(0), []
    for _ in range(200):
        play = np.array([*rng.uniform(-2e-4, 2e-4, 2), 0.0, *rng.uniform(-5e-3, 5e-3, 3)])
        length = TOOL.moved([0.0, 0.0, rng.normal(0.0, KNOWN.length_sigma_m)])
        found = tool_by_mating([dock(rng.normal(size=6) * SIGMA, play)], replace(KNOWN, T_flange_tcp=length))
        off = error_of(found.T_flange_tcp)
        squares.append(float(off @ np.linalg.solve(found.covariance, off)))
    assert np.mean(squares) == pytest.approx(6.0, abs=1.2)


def test_what_the_hand_eye_calibration_adds_is_not_in_the_tools_own_covariance() -> None:
    found = tool_by_mating([dock()], KNOWN)
    worse = tool_by_mating([dock()], replace(KNOWN, scanner_covariance=9.0 * KNOWN.scanner_covariance))
    np.testing.assert_allclose(worse.own_covariance, found.own_covariance)
    assert np.trace(worse.covariance[:3, :3]) > 4.0 * np.trace(found.covariance[:3, :3])


def test_a_plug_pushed_deeper_leaves_the_tools_length_alone_and_says_so() -> None:
    found = tool_by_mating([dock(play=np.array([0.0, 0.0, 0.0008, 0.0, 0.0, 0.0]))], KNOWN)
    assert found.deeper_m == pytest.approx(0.0008, abs=1e-6)
    assert found.T_flange_tcp.distance_to(TOOL) < 1e-9


def test_too_few_looks_and_looks_from_one_side_are_refused() -> None:
    with pytest.raises(CalibrationError, match="2 looks after dock 2 are too few"):
        tool_by_mating([dock(), dock(sides=SIDES[:2])], KNOWN)
    with pytest.raises(CalibrationError, match="parallel") as caught:
        tool_by_mating([dock(sides=((0.0, 0.0), (0.05, 0.0), (0.0, 0.05)))], KNOWN)
    assert "sides" in caught.value.remedy
    with pytest.raises(CalibrationError, match="no dock"):
        tool_by_mating([], KNOWN)


def test_a_vehicle_that_moved_is_refused() -> None:
    one = dock()
    moved = replace(one, T_base_port_before=one.T_base_port_before @ exp([0.001, 0, 0, 0, 0, 0]))
    with pytest.raises(CalibrationError, match=r"after dock 2 the port is seen 1\.00 mm"):
        tool_by_mating([one, moved], KNOWN)


def test_docks_that_disagree_on_the_tool_are_refused() -> None:
    with pytest.raises(CalibrationError, match="looks disagree"):
        tool_by_mating([dock(), dock(play=np.array([0.002, 0.0, 0.0, 0.0, 0.0, 0.0]))], KNOWN)


def test_a_hand_eye_that_is_far_off_shows_as_looks_that_disagree() -> None:
    with pytest.raises(CalibrationError):
        tool_by_mating([dock(np.array([0.005, 0.0, 0.0, 0.0, 0.02, 0.0]))], KNOWN)
