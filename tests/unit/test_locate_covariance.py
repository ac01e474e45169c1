"""The covariance knows how the scan was taken: less is certain along the sweep than along the laser's line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.port_files import load_port
from perception.covariance import covariance
from perception.crop import crop
from perception.evaluation.scenes import simulate_scan
from perception.geometry import Array
from perception.port_model import PortModel
from perception.port_solid import build_mesh
from perception.refine import Refined, refine

ALONG_X, ALONG_Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def refined() -> Refined:
    shape = load_port("type2").shape
    scan = simulate_scan(shape, "nominal", np.random.default_rng(3))
    model = PortModel.from_mesh("type2", *build_mesh(shape))
    return refine(scan.prior.T_ref_port.inverse() @ scan.T_scanner_port, crop(scan.cloud, model, scan.prior), model)


def variances(refined: Refined, sweep: Array) -> Array:
    return np.diag(covariance(replace(refined, sweep=sweep)))


def test_the_sweep_of_a_scan_is_known_in_the_ports_frame(refined: Refined) -> None:
    assert np.linalg.norm(refined.sweep) == pytest.approx(1.0)
    assert abs(refined.sweep[1]) > 0.8  # scenes are swept along y, give or take the prior's roll


def test_what_no_residual_shows_is_larger_along_the_sweep_and_turns_with_it(refined: Refined) -> None:
    by_x, by_y = variances(refined, ALONG_X), variances(refined, ALONG_Y)
    assert by_x[0] - by_y[0] == pytest.approx(by_y[1] - by_x[1])
    assert by_x[0] - by_y[0] > (0.1 * refined.scale_m) ** 2
    assert by_x[4] > by_y[4] and by_y[3] > by_x[3]  # swept along x, the port seems to tilt about y
    assert by_x[[2, 5]] == pytest.approx(by_y[[2, 5]])


def test_a_sweep_of_unknown_speed_moves_a_port_beside_its_middle_along_the_sweep_and_nowhere_else(
    refined: Refined,
) -> None:
    askew = np.array([0.0, 0.94, 0.34])
    beside = replace(refined.stretch, share=0.004, port_at_m=0.03)
    middle = replace(refined.stretch, share=0.004, port_at_m=0.0)
    more = covariance(replace(refined, sweep=askew, stretch=beside)) - covariance(
        replace(refined, sweep=askew, stretch=middle)
    )
    along = float(more[1, 1]) / askew[1] ** 2
    assert np.sqrt(along) == pytest.approx(0.03 * np.hypot(0.0012, 0.004), rel=0.01)
    assert more[:3, :3] == pytest.approx(np.outer(askew, askew) * along, abs=1e-3 * along)


def test_flats_at_odds_in_depth_are_uncertain_along_the_axis_alone(refined: Refined) -> None:
    sure = np.diag(covariance(replace(refined, depth_dispute_m=0.0002)))
    at_odds = np.diag(covariance(replace(refined, depth_dispute_m=-0.0007)))
    assert at_odds[2] - sure[2] == pytest.approx(0.0005**2)
    assert np.delete(at_odds, 2) == pytest.approx(np.delete(sure, 2))
