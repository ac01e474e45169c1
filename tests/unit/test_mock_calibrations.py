"""The dry run's cell docks by its calibrations alone: what they leave fits a port, what the site file says does not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from controller.config import SiteConfig, load_config
from controller.mock_calibrations import CELL, as_calibrated, cell_name, has_hidden_latency, stands_for
from controller.port_files import load_port
from controller.scenarios import Scenario, draw_scenario
from drivers.arm.kinematics import MODELS, JointLimits, forward, frames_many, nearest_branch
from perception.calibration.arm_errors import Weights, true_in_told
from perception.geometry import Pose

SITE = load_config()
CCS2 = load_port("ccs2")
BEFORE_THE_PORT = np.array([2.97, -1.2, 2.1, 2.2, -1.3, 0.0])
LOOKING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.29]))


def worlds() -> Iterator[Scenario]:
    return (draw_scenario("nominal", SITE, CCS2, seed) for seed in range(25))


def moved_by(errors: np.ndarray | None, told: Pose) -> Pose:
    """The flange that an arm with such errors has where it tells ``told``."""
    joints = nearest_branch(MODELS["ur10e"], told, BEFORE_THE_PORT, JointLimits.symmetric())
    assert joints is not None
    frames = frames_many(MODELS["ur10e"], joints[None])
    return (
        told
        if errors is None
        else forward(MODELS["ur10e"], joints) @ Pose.from_matrix(true_in_told(frames, errors, Weights())[0])
    )


def true_errors(world: Scenario) -> np.ndarray:
    unknown = world.miscalibration
    d1, a2, a3, d4, d5, d6 = unknown.links_m
    lengths = [0, a2, a3, 0, 0, 0, d1, 0, 0, d4, d5, d6]
    return np.array([*lengths, *unknown.joints, unknown.compliance_rad_per_nm])


def plug_off(world: Scenario, known: SiteConfig) -> Pose:
    """The true plug in its mated place's frame, after a perfect scan and a dock by what the controller knows."""
    believed, errors = known.scanner.T_flange_scanner.pose, known.arm.errors.errors
    told = world.T_base_port @ LOOKING @ believed.inverse()
    true_scanner = (
        moved_by(true_errors(world), told) @ SITE.scanner.T_flange_scanner.pose @ world.miscalibration.scanner
    )
    seen = moved_by(errors, told) @ believed @ true_scanner.inverse() @ world.T_base_port
    taught = known.port.T_port_tcp
    wanted = seen @ (CCS2.T_port_tcp if taught is None else taught.pose) @ known.arm.T_flange_tcp.pose.inverse()
    commanded = wanted @ (wanted.inverse() @ moved_by(errors, wanted)).inverse()
    plug = moved_by(true_errors(world), commanded) @ SITE.arm.T_flange_tcp.pose @ world.miscalibration.tool
    return CCS2.T_port_tcp.inverse() @ world.T_base_port.inverse() @ plug


def test_with_the_kept_calibrations_the_plug_meets_the_port() -> None:
    known = as_calibrated(SITE)
    off = [plug_off(world, known) for world in worlds()]
    assert max(np.hypot(*one.translation[:2]) for one in off) < 0.6 * CCS2.capture_radius_m
    assert max(one.angle_to(Pose.identity()) for one in off) < 0.3 * CCS2.capture_tilt_rad


def test_without_them_it_misses_by_more_than_any_search_bridges() -> None:
    off = [np.hypot(*plug_off(world, SITE).translation[:2]) for world in worlds()]
    assert min(off) > 5.0 * CCS2.capture_radius_m


def test_a_port_that_was_not_taught_is_still_met() -> None:
    known = as_calibrated(SITE)
    untaught = known.model_copy(update={"port": SITE.port})
    assert untaught.port.T_port_tcp is None
    assert max(np.hypot(*plug_off(world, untaught).translation[:2]) for world in worlds()) < CCS2.capture_radius_m


def test_cars_come_and_go_and_the_cell_stays() -> None:
    first, second = (draw_scenario("nominal", SITE, CCS2, seed) for seed in (1, 2))
    assert first.T_base_port.distance_to(second.T_base_port) > 1e-3
    assert first.miscalibration.joints == second.miscalibration.joints
    raw = draw_scenario("uncalibrated", SITE, CCS2, 1, CELL)
    assert raw.miscalibration.joints == first.miscalibration.joints
    assert (first.calibrated, raw.calibrated) == (True, False)
    names = [
        cell_name(SITE, "nominal", 3, None),
        cell_name(SITE, "nominal", 3, 3),
        cell_name(SITE, "uncalibrated", 3, None),
    ]
    assert len(set(names)) == 3, "each cell's calibrations are for it alone"
    assert cell_name(SITE, "blocked", 4, None) == names[0], "the same cell whatever is before it"


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("scanner", "T_flange_scanner", SITE.arm.T_flange_tcp),
        ("arm", "T_flange_tcp", SITE.scanner.T_flange_scanner),
        ("arm", "model", "ur5e"),
        ("scanner", "latency_ms", 3.0),
    ],
)
def test_a_site_that_is_built_otherwise_meets_a_cell_of_its_own(section: str, key: str, value: object) -> None:
    other = SITE.model_copy(update={section: getattr(SITE, section).model_copy(update={key: value})})
    assert stands_for(SITE)
    assert not stands_for(other)
    assert not draw_scenario("nominal", other, CCS2, 1).calibrated


def test_a_named_cell_has_what_a_good_calibration_leaves() -> None:
    world = draw_scenario("nominal", SITE, CCS2, 1, cell=3)
    assert not world.calibrated
    assert np.linalg.norm(world.miscalibration.scanner.translation) < 1e-3


def test_the_clock_is_corrected_only_where_it_is_off() -> None:
    sweeping, triggered = (
        SITE.model_copy(update={"scanner": SITE.scanner.model_copy(update={"sync": sync})})
        for sync in ("shared_clock", "trigger")
    )
    assert has_hidden_latency(sweeping.scanner)
    assert not has_hidden_latency(triggered.scanner)
    late_ms = 1e3 * draw_scenario("uncalibrated", SITE, CCS2, 0, CELL).miscalibration.latency_s
    assert as_calibrated(sweeping).scanner.latency_ms == pytest.approx(late_ms, abs=0.6)
    assert as_calibrated(triggered).scanner.latency_ms == SITE.scanner.latency_ms


def test_what_is_taught_at_the_site_stays_and_other_ports_are_not_taught() -> None:
    own = SITE.port.model_copy(update={"T_port_tcp": SITE.scanner.T_flange_scanner})
    assert as_calibrated(SITE.model_copy(update={"port": own})).port.T_port_tcp == SITE.scanner.T_flange_scanner
    type2 = SITE.port.model_copy(update={"model": "type2"})
    assert as_calibrated(SITE.model_copy(update={"port": type2})).port.T_port_tcp is None
    assert as_calibrated(SITE).port.T_port_tcp is not None
