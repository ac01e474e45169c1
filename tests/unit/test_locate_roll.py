"""The roll of round ports, which only their smallest parts tell; a pose that stopped on its way is refined again."""

from __future__ import annotations

import numpy as np
import pytest

from controller.port_files import bundled_ports, load_port
from perception.crop import crop
from perception.evaluation.locate_cases import Case, make_scan, positive_cases
from perception.geometry import Pose
from perception.locate import LocateSettings, _refine_and_judge, locate
from perception.port_model import PortModel
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


@pytest.mark.parametrize("port", ["j1772", "type2"])
def test_a_pose_that_stopped_on_its_way_to_the_right_roll_is_looked_at_again(port: str) -> None:
    shapes = {port: load_port(port).shape}
    scan = make_scan(Case("port", 70, "nominal", port, port), 60, shapes)
    model = PortModel.from_mesh(port, *build_mesh(shapes[port]))
    assert scan.T_scanner_port is not None
    truth, scene = scan.prior.T_ref_port.inverse() @ scan.T_scanner_port, crop(scan.cloud, model, scan.prior)
    start = truth @ Pose.from_rotvec([0.0, 0.0, np.deg2rad(50.0)])
    first, doubted = _refine_and_judge(start, scene, model, LocateSettings(second_looks=0))
    assert first.T_prior_port.angle_to(truth) > np.deg2rad(4.0)
    assert doubted.doubtful
    again, evidence = _refine_and_judge(start, scene, model, LocateSettings())
    assert not evidence.doubtful
    assert again.T_prior_port.angle_to(truth) < np.deg2rad(0.2)
    assert again.T_prior_port.distance_to(truth) < 0.0002
