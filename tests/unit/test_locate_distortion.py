"""A scan that was not taken as its poses say is out of proportion: it is refused, and the reason names how."""

from __future__ import annotations

import re

import numpy as np
import pytest

from controller.port_files import load_port
from perception.distortion import Distortion
from perception.estimate import PortEstimate, Prior
from perception.evaluation.locate_cases import CaseScan, make_scan, positive_cases
from perception.evidence import Evidence
from perception.gate import MAX_LEAN_RAD, MAX_SHEAR_RAD, MAX_STRETCH, MIN_EXPLAINED, Findings, reasons_against
from perception.geometry import Pose
from perception.locate import locate
from perception.port_model import AcceptanceLimits, PortModel
from perception.port_solid import build_mesh
from perception.scan import Cloud

SHAPES = {name: load_port(name).shape for name in ("ccs2", "type2")}
TAN3 = float(np.tan(np.deg2rad(3.0)))


def scan_of(port: str) -> tuple[CaseScan, PortModel]:
    case = next(case for case in positive_cases(8, [port], ("nominal",)))
    return make_scan(case, 3, SHAPES), PortModel.from_mesh(case.port, *build_mesh(SHAPES[case.port]))


@pytest.fixture(scope="module")
def scanned() -> tuple[CaseScan, PortModel]:
    return scan_of("type2")


def located(scan: CaseScan, model: PortModel, change: np.ndarray) -> PortEstimate:
    """In the scan whose points were moved by ``change`` (3, 3) in the port's frame."""
    truth = scan.T_scanner_port
    assert truth is not None
    moved = truth.apply(truth.inverse().apply(scan.cloud.points) @ (np.eye(3) + change).T)
    return locate(Cloud(moved, scan.cloud.frame, scan.cloud.origins), model, scan.prior)


def change(row: str, column: str, amount: float) -> np.ndarray:
    found = np.zeros((3, 3))
    found["xyz".index(row), "xyz".index(column)] = amount
    return found


def test_a_scan_in_proportion_is_accepted(scanned: tuple[CaseScan, PortModel]) -> None:
    assert located(*scanned, np.zeros((3, 3))).accepted


def test_so_it_is_with_a_port_that_is_not_round() -> None:
    scanned = scan_of("ccs2")
    assert located(*scanned, np.zeros((3, 3))).accepted
    assert not located(*scanned, change("x", "y", TAN3)).accepted


@pytest.mark.parametrize(
    ("how", "says"),
    [
        (change("x", "y", TAN3), r"sheared by (2\.[6-9]|3\.[0-4]) deg"),
        (change("x", "y", -TAN3), r"sheared by (2\.[6-9]|3\.[0-4]) deg"),
        (change("y", "x", TAN3), "sheared by"),
        (change("y", "y", 0.03), "too long along y"),
        (change("x", "x", -0.03), "too short along x"),
        (change("z", "y", 1.6 * TAN3), "leaning by"),
    ],
    ids=["sheared", "sheared the other way", "sheared along the other axis", "long", "short", "leaning"],
)
def test_a_scan_out_of_proportion_is_refused_and_the_reason_names_how(
    scanned: tuple[CaseScan, PortModel], how: np.ndarray, says: str
) -> None:
    found = located(*scanned, how)
    assert not found.accepted
    assert any(re.search(says, reason) and "check hand-eye" in reason for reason in found.reasons), found.reasons


EXPLAINED = 1.5 * MIN_EXPLAINED


@pytest.mark.parametrize(
    ("found", "refused"),
    [
        (Distortion(0.9 * MAX_SHEAR_RAD, 0.0, 0.0, 0.0, EXPLAINED), False),
        (Distortion(1.1 * MAX_SHEAR_RAD, 0.0, 0.0, 0.0, EXPLAINED), True),
        (Distortion(0.0, -1.1 * MAX_STRETCH, 0.0, 0.0, EXPLAINED), True),
        (Distortion(0.0, 0.0, 1.1 * MAX_STRETCH, 0.0, EXPLAINED), True),
        (Distortion(0.0, 0.9 * MAX_STRETCH, -0.9 * MAX_STRETCH, 0.0, EXPLAINED), False),
        (Distortion(0.0, 0.0, 0.0, 1.1 * MAX_LEAN_RAD, EXPLAINED), True),
        (Distortion(9.0 * MAX_SHEAR_RAD, 1.0, 1.0, 1.0, 0.9 * MIN_EXPLAINED), False),
    ],
)
def test_only_a_large_distortion_that_explains_what_contradicts_is_a_reason(found: Distortion, refused: bool) -> None:
    evidence = Evidence(1000.0, 0.0, 0.0, 0.8, 10, 10, 0, 0.6, 0.0, 100, 0, 1.0)
    findings = Findings(Pose.identity(), np.diag([1e-10] * 6), 1e-4, evidence, 0.5, found)
    assert bool(reasons_against(findings, Prior(Pose.identity()), AcceptanceLimits())) is refused
