"""The poses of a hand-eye calibration: what they differ in, what keeps the plug clear, what their choice foretells."""

from __future__ import annotations

import numpy as np
import pytest

from controller.calibrations.views import CLEAR_M, View, candidates, reachable, sweep_of
from controller.config import load_config
from perception.calibration.foresight import Expected, Foreseen, Sweep, best_next, covariance_after, foreseen, spread
from perception.calibration.hand_eye import Asked
from perception.calibration.sightings import Mounting
from perception.calibration.targets import SphereTarget

CONFIG = load_config()
TARGET = CONFIG.port.T_base_port.pose
TCP = CONFIG.arm.T_flange_tcp.pose
MOUNTING = Mounting(CONFIG.scanner.T_flange_scanner.pose)


def told(view: View) -> Foreseen:
    planned = sweep_of(view, TARGET, CONFIG.scan, MOUNTING.T_flange_scanner.inverse() @ TCP)
    ends = planned.T_base_tcp_start @ TCP.inverse(), planned.T_base_tcp_end @ TCP.inverse()
    return foreseen(Sweep(*ends, 5.0), SphereTarget(TARGET.translation, 0.0254), MOUNTING, Asked())


def test_every_candidate_sees_the_target_whole() -> None:
    square = told(View()).points
    assert square > 300
    assert min(told(view).points for view in candidates(12)) > 0.6 * square


def test_sweeps_that_say_most_leave_the_mounting_less_uncertain_than_the_first_that_come() -> None:
    all_views = [told(view) for view in candidates(24)]
    made, left = [told(View())], list(all_views)
    for _ in range(5):
        made.append(left.pop(best_next(made, left, Expected(), 0.29)))
    chosen = spread(covariance_after(made, Expected()))
    first = spread(covariance_after([told(View()), *all_views[:5]], Expected()))
    assert chosen[0] ** 2 + (0.29 * chosen[1]) ** 2 <= first[0] ** 2 + (0.29 * first[1]) ** 2
    assert np.isfinite(chosen).all()


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
