"""Hand-eye calibration from sweeps of a port as it was built, with the model as it was drawn."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from controller.calibrations.views import View, candidates, sweep_of
from controller.config import load_config
from controller.port_files import load_port
from controller.port_models import port_model
from perception.calibration.errors import CalibrationError
from perception.calibration.find_port import find_port
from perception.calibration.from_sweeps import Solved, checked, solve_port_sweeps
from perception.calibration.hand_eye import Asked
from perception.calibration.sightings import Mounting, sightings
from perception.calibration.targets import PortTarget
from perception.evaluation.scene import Negative, SceneSpec, build_scene
from perception.evaluation.sensor import SensorModel, cast_sweep
from perception.geometry import Array, Pose, exp
from perception.scan import Profile, Scan

CONFIG = load_config()
EXPECTED = CONFIG.port.T_base_port.pose
TRUE_PORT = EXPECTED @ exp([0.008, -0.006, 0.005, 0.04, -0.03, 0.02])
TRUE = CONFIG.scanner.T_flange_scanner.pose
TCP = CONFIG.arm.T_flange_tcp.pose
OFFSET_S = 0.004
PROFILES = 180
NEAR = TRUE @ exp([0.0005, -0.0004, 0.0003, 0.002, -0.0015, 0.002])
FAR = TRUE @ Pose.from_rotvec(np.deg2rad([-6.2, 6.7, 4.2]), [0.0095, 0.0009, 0.0176])
"""20 mm and 10 deg off."""


def sweep(view: View, guess: Pose, negative: Negative | None, rng: np.random.Generator) -> Scan:
    """Planned with the guess, measured with the truth, 4 ms later than its time stamps say."""
    planned = sweep_of(view, EXPECTED, CONFIG.scan, guess.inverse() @ TCP)
    start, end = planned.T_base_tcp_start @ TCP.inverse(), planned.T_base_tcp_end @ TCP.inverse()
    times_s = np.arange(PROFILES) / PROFILES * CONFIG.scan.length_mm / CONFIG.scan.speed_mm_s
    velocity = (end.translation - start.translation) / times_s[-1]
    true = [TRUE_PORT.inverse() @ Pose(start.rotation, start.translation + velocity * (t + OFFSET_S)) @ TRUE
            for t in times_s]  # fmt: skip
    cast = cast_sweep(scene(negative), true, replace(SensorModel(), points_per_profile=400), rng)
    points = cast.T_port_scanner.apply(cast.cloud.points)
    profiles = [
        Profile(k, float(t), float(t), pose.inverse().apply(points[cast.profile == k])[:, [0, 2]])
        for k, (t, pose) in enumerate(zip(times_s, true, strict=True))
    ]
    return Scan(tuple(profiles), tuple(Pose(start.rotation, start.translation + velocity * t) for t in times_s), guess)


@lru_cache
def scene(negative: Negative | None):
    return build_scene(SceneSpec(load_port("ccs2").shape, negative), np.random.default_rng(5))


def sweeps(guess: Pose, count: int = 6, negative: Negative | None = None) -> list[Scan]:
    rng = np.random.default_rng(1)
    return [sweep(view, guess, negative, rng) for view in (View(), *candidates(count - 1))]


def error(solved: Solved) -> Array:
    found = solved.hand_eye.mounting.T_flange_scanner
    return np.concatenate([found.translation - TRUE.translation, (TRUE.inverse() @ found).rotvec])


@pytest.mark.slow
def test_sweeps_of_a_port_give_mounting_and_time_offset_as_certain_as_is_stated() -> None:
    solved = solve_port_sweeps(sweeps(NEAR), port_model("ccs2"), TRUE_PORT, Mounting(NEAR), Asked())
    off = error(solved)
    assert np.linalg.norm(off[:3]) < 0.0004
    assert np.rad2deg(np.linalg.norm(off[3:])) < 0.08
    assert solved.hand_eye.mounting.time_offset_s == pytest.approx(OFFSET_S, abs=0.0008)
    assert off @ np.linalg.solve(solved.hand_eye.covariance[:6, :6], off) < 22.5  # chi2, 6 degrees, 99.9 %


@pytest.mark.long
def test_a_sweep_of_a_port_is_foretold_by_the_others() -> None:
    solved = solve_port_sweeps(sweeps(NEAR), port_model("ccs2"), TRUE_PORT, Mounting(NEAR), Asked())
    assert checked(solved, Asked()).max() < 0.0005


@pytest.mark.long
def test_a_guess_20_mm_and_10_deg_off_is_close_enough_to_find_the_port_in_every_sweep() -> None:
    seen = sightings(sweeps(FAR, count=4), max_points=20_000)
    found = find_port(seen, port_model("ccs2"), EXPECTED, Mounting(FAR))
    assert found.mounting.T_flange_scanner.distance_to(TRUE) < 0.002
    assert np.rad2deg(found.mounting.T_flange_scanner.angle_to(TRUE)) < 0.5
    assert found.target.T_base_port.distance_to(TRUE_PORT) < 0.001


@pytest.mark.slow
def test_a_panel_without_a_port_is_refused() -> None:
    seen = sightings(sweeps(NEAR, count=1, negative="plain"), max_points=20_000)
    with pytest.raises(CalibrationError, match="port") as caught:
        find_port(seen, port_model("ccs2"), EXPECTED, Mounting(NEAR))
    assert "port.model" in caught.value.remedy


def test_the_own_parameters_are_the_derivative_of_the_distances() -> None:
    model = port_model("ccs2")
    target = PortTarget.at(TRUE_PORT, model.surface)
    points = TRUE_PORT.apply(model.surface.points + 1e-5)[::3]
    target = target.with_free_depths(points)
    assert target.parameters > 6
    here, step = target.distances(points), 1e-7
    numeric = [
        (target.moved(step * axis).distances(points).residual - here.residual) / step
        for axis in np.eye(target.parameters)
    ]
    np.testing.assert_allclose(here.own, np.stack(numeric, axis=1), atol=1e-3)
