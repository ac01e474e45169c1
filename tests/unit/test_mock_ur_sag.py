"""The emulated arm is not quite where it says: its links' weight bends its joints, and its lengths are not as drawn."""

from __future__ import annotations

import numpy as np
import pytest

from controller.config import load_config
from controller.port_files import load_port
from controller.scenarios import SCENARIOS, draw_scenario
from mocks.ur.arm import Arm, FreeSpace, Sensor
from mocks.ur.kinematics import MODELS, Kinematics, as_built
from mocks.ur.sag import G_M_S2, LINK_KG, TOOL_KG, Sag

KINEMATICS = Kinematics(MODELS["ur10e"])
STRETCHED = np.array([0.0, -0.3, 0.3, -1.5, -1.5, 0.0])


def potential_j(q: np.ndarray) -> float:
    """Of the links' weight, link by link."""
    points = np.vstack([np.zeros(3), KINEMATICS.links(q)[:, :3, 3]])
    middles = 0.5 * (points[:-1] + points[1:])
    return float(G_M_S2 * (LINK_KG @ middles[:, 2] + TOOL_KG * points[-1, 2]))


@pytest.mark.parametrize("seed", range(5))
def test_torques_are_the_slope_of_the_potential(seed: int) -> None:
    q = np.random.default_rng(seed).uniform(-2.0, 2.0, 6)
    step = 1e-6
    slope = [(potential_j(q + step * e) - potential_j(q - step * e)) / (2 * step) for e in np.eye(6)]
    np.testing.assert_allclose(Sag(KINEMATICS, 3e-6).torques(q), -np.array(slope), atol=1e-4)


def arm(sag: Sag | None, built: Kinematics | None = None) -> Arm:
    sensor = Sensor(np.random.default_rng(0), 0, 0, 0, 0)
    return Arm(KINEMATICS, STRETCHED, FreeSpace(), sensor, sag=sag, built=built)


def test_the_flange_hangs_lower_than_the_arm_says_and_a_rigid_one_does_not() -> None:
    hanging, rigid = arm(Sag(KINEMATICS, 3e-6)), arm(None)
    lower_m = rigid.T_base_flange_true[2, 3] - hanging.T_base_flange_true[2, 3]
    assert 0.0002 < lower_m < 0.002
    np.testing.assert_array_equal(hanging.q, rigid.q)
    np.testing.assert_array_equal(hanging.reference.links[5], rigid.reference.links[5])


@pytest.mark.parametrize("seed", range(5))
def test_what_is_reused_on_a_short_way_is_less_than_a_micrometre_off_at_the_flange(seed: int) -> None:
    rng, reusing = np.random.default_rng(seed), Sag(KINEMATICS, 3e-6)
    before = rng.uniform(-2.0, 2.0, 6)
    reusing.deflection(before)
    for way_rad in (1e-3, 0.1):
        q = before + way_rad * rng.uniform(-1.0, 1.0, 6)
        flanges = [KINEMATICS.flange(q + sag.deflection(q)) for sag in (reusing, Sag(KINEMATICS, 3e-6))]
        assert np.linalg.norm(flanges[0][:3, 3] - flanges[1][:3, 3]) < 1e-6


def test_the_true_flange_moves_with_the_joints() -> None:
    hanging = arm(Sag(KINEMATICS, 3e-6))
    first = hanging.T_base_flange_true
    hanging.reference.advance(STRETCHED + 0.01, 0.1)
    assert np.linalg.norm(hanging.T_base_flange_true[:3, 3] - first[:3, 3]) > 0.001


@pytest.mark.parametrize("length", range(6))
def test_a_length_that_is_off_moves_the_true_flange_by_as_much_and_the_reported_one_not_at_all(length: int) -> None:
    errors_m = 0.0002 * np.eye(6)[length]
    wrong = arm(None, Kinematics(as_built(MODELS["ur10e"], errors_m)))
    moved = wrong.T_base_flange_true[:3, 3] - wrong.reference.links[5][:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(0.0002, rel=1e-9)
    np.testing.assert_array_equal(wrong.reference.links[5], arm(None).reference.links[5])


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenarios_arm_is_as_long_as_its_own_cell_has_it(name: str) -> None:
    config, port = load_config(), load_port("ccs2")
    lengths = np.array([draw_scenario(name, config, port, 0, cell).miscalibration.links_m for cell in range(40)])
    assert 0.00010 < lengths.std() < 0.00013, "evenly up to 0.2 mm"
    assert np.abs(lengths).max() < 0.0002
    assert len(np.unique(lengths)) == lengths.size


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenarios_arm_gives_by_its_cells_own_measure(name: str) -> None:
    config, port = load_config(), load_port("ccs2")
    first, second = (draw_scenario(name, config, port, 0, cell).miscalibration.compliance_rad_per_nm for cell in (1, 2))
    assert first != second
    assert min(first, second) > 1e-6
