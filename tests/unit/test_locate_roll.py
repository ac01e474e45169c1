"""Walls and edges must agree about the roll: refinement that drifts away from the edges is done again, or refused."""

from __future__ import annotations

import numpy as np
import pytest

from controller.port_files import bundled_ports, load_port
from perception.estimate import Prior
from perception.evaluation.locate_cases import Case, make_scan, positive_cases
from perception.evidence import Evidence
from perception.gate import MAX_ROLL_DISPUTE_RAD, Findings, reasons_against
from perception.geometry import Pose
from perception.locate import LocateSettings, locate
from perception.port_model import AcceptanceLimits, PortModel
from perception.port_solid import build_mesh


def test_a_round_port_whose_walls_pull_it_a_degree_off_is_found() -> None:
    shapes = {name: load_port(name).shape for name in bundled_ports()}
    case = next(case for case in positive_cases(16, list(shapes)) if case.number == 14)
    scan = make_scan(case, 7, shapes)
    found = locate(scan.cloud, PortModel.from_mesh(case.port, *build_mesh(shapes[case.port])), scan.prior)
    assert case.port == "gbt_ac"
    assert scan.T_scanner_port is not None
    assert np.rad2deg(found.T_ref_port.angle_to(scan.T_scanner_port)) < 0.3


def test_a_clear_scan_of_a_round_port_is_found_though_few_of_its_points_leave_the_roll_open() -> None:
    shapes = {name: load_port(name).shape for name in bundled_ports()}
    case = next(case for case in positive_cases(45, list(shapes)) if case.number == 44)
    scan = make_scan(case, 9, shapes)
    found = locate(scan.cloud, PortModel.from_mesh(case.port, *build_mesh(shapes[case.port])), scan.prior)
    assert (case.port, case.tier) == ("gbt_ac", "easy")
    assert found.accepted
    assert scan.T_scanner_port is not None
    assert found.T_ref_port.distance_to(scan.T_scanner_port) < 0.0001


@pytest.mark.parametrize(
    "case",
    [Case("port", 70, "nominal", "j1772", "j1772"), Case("port", 2, "hard", "ccs1", "ccs1")],
    ids=lambda c: c.port,
)
def test_a_pose_that_stopped_on_its_way_to_the_right_roll_is_looked_at_again(case: Case) -> None:
    shapes = {case.port: load_port(case.port).shape}
    scan = make_scan(case, 60, shapes)
    model = PortModel.from_mesh(case.port, *build_mesh(shapes[case.port]))
    assert scan.T_scanner_port is not None
    first = locate(scan.cloud, model, scan.prior, LocateSettings(second_looks=0))
    assert not first.accepted and first.T_ref_port.angle_to(scan.T_scanner_port) > np.deg2rad(8.0)
    again = locate(scan.cloud, model, scan.prior)
    assert again.accepted, again.reasons
    assert again.T_ref_port.angle_to(scan.T_scanner_port) < np.deg2rad(0.2)
    assert again.T_ref_port.distance_to(scan.T_scanner_port) < 0.0002


def good(dispute_rad: float) -> Findings:
    evidence = Evidence(1000.0, 0.0, 0.0, 0.8, 10, 10, 0, 0.6, 0.0, 100, 0, 1.0)
    return Findings(Pose.identity(), np.diag([1e-10] * 6), 1e-4, evidence, 0.5, dispute_rad)


def test_a_dispute_about_the_roll_is_a_reason_to_refuse() -> None:
    limits, prior = AcceptanceLimits(), Prior(Pose.identity())
    assert reasons_against(good(0.5 * MAX_ROLL_DISPUTE_RAD), prior, limits) == ()
    (reason,) = reasons_against(good(1.5 * MAX_ROLL_DISPUTE_RAD), prior, limits)
    assert "disagree about the roll by 0.9 deg" in reason
