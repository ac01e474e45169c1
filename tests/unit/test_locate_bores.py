"""A socket's bores show no surface to a scanner: that they are empty speaks for the port, a filled one against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.port_files import load_port
from perception.crop import Scene
from perception.estimate import Prior
from perception.evidence import Evidence, judge
from perception.front_map import CELL_M
from perception.gate import Findings, reasons_against
from perception.geometry import Array, Pose
from perception.port_model import AcceptanceLimits, PortModel
from perception.port_solid import build_mesh

PRIOR = Prior(Pose.identity())
FACE_Z_M = -0.003
"""The face that GB/T AC's bores open in."""


@pytest.fixture(scope="module")
def gbt_ac() -> PortModel:
    return PortModel.from_mesh("gbt_ac", *build_mesh(load_port("gbt_ac").shape))


def scene(points: Array) -> Scene:
    none, laser = np.zeros((0, 3)), np.array([0.0, 0.0, 0.3])
    return Scene(points, points + laser, none, none, np.array([0.0, 1.0, 0.0]), laser)


def face_points(filled: bool) -> Array:
    """(N, 3) points 0.4 mm apart on the insert's face; the bores' places are left out unless ``filled``."""
    x, y = np.meshgrid(np.arange(-0.021, 0.021, 0.0004), np.arange(-0.018, 0.016, 0.0004))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, FACE_Z_M)])
    if filled:
        return points
    power = [(0.0, 0.0), (-0.016, 0.0), (0.016, 0.0), (-0.008, -0.01385), (0.008, -0.01385)]
    signal = [(-0.008, 0.0112), (0.008, 0.0112)]
    bores = [(centre, 0.0033) for centre in power] + [(centre, 0.0019) for centre in signal]
    keep = np.ones(len(points), dtype=bool)
    for centre, radius in bores:
        keep &= np.hypot(*(points[:, :2] - centre).T) > radius
    return points[keep]


def test_the_five_power_bores_are_features(gbt_ac: PortModel) -> None:
    assert gbt_ac.front.bores >= 5


def test_empty_bores_are_seen(gbt_ac: PortModel) -> None:
    found = judge(Pose.identity(), scene(face_points(filled=False)), gbt_ac, 1e-4)
    assert found.features_seen >= 5
    assert found.features_denied == 0


def test_filled_bores_contradict_the_port(gbt_ac: PortModel) -> None:
    found = judge(Pose.identity(), scene(face_points(filled=True)), gbt_ac, 1e-4)
    assert found.features_denied >= 5


def test_a_few_flying_points_over_a_well_that_shows_no_floor_deny_nothing_and_a_filled_well_is_denied() -> None:
    chademo = PortModel.from_mesh("chademo", *build_mesh(load_port("chademo").shape))
    front = chademo.front
    wells = [k for k in range(1, front.features + 1) if np.nanmax(front.highest[front.feature == k]) < -0.03]
    cells = np.argwhere(front.feature == wells[0])
    over = np.column_stack([front.low + (cells + 0.5) * CELL_M, np.full(len(cells), -0.006)])
    rim = np.column_stack([np.linspace(-0.03, 0.03, 300), np.full(300, -0.0385), np.zeros(300)])
    few = judge(Pose.identity(), scene(np.vstack([rim, over[:6]])), chademo, 1e-4)
    filled = judge(Pose.identity(), scene(np.vstack([rim, over])), chademo, 1e-4)
    assert len(cells) > 150
    assert (few.features_denied, filled.features_denied) == (0, 1)


def test_without_points_around_it_a_bore_says_nothing(gbt_ac: PortModel) -> None:
    rim_only = np.column_stack([np.linspace(-0.03, 0.03, 300), np.full(300, -0.031), np.zeros(300)])
    found = judge(Pose.identity(), scene(rim_only), gbt_ac, 1e-4)
    assert found.features_seen == 0


def test_half_of_the_features_that_no_depth_hides_must_be_seen_two_at_most(gbt_ac: PortModel) -> None:
    chademo = PortModel.from_mesh("chademo", *build_mesh(load_port("chademo").shape))
    assert (int(chademo.front.reachable.sum()), chademo.front.features) == (2, 6)
    good = Evidence(1000.0, 0.0, 0.0, 0.8, 6, 6, 0, 0.6, 0.0, 100, 0, 1.0)

    def refused(reachable: int, seen: int) -> bool:
        evidence = replace(good, reachable=reachable, reachable_seen=seen)
        findings = Findings(Pose.identity(), np.diag([1e-10] * 6), 1e-4, evidence, 0.5)
        return any("contacts and wells are seen" in r for r in reasons_against(findings, PRIOR, AcceptanceLimits()))

    assert [refused(2, k) for k in range(3)] == [True, False, False]
    assert [refused(7, k) for k in range(4)] == [True, True, False, False]
    assert [refused(1, k) for k in range(2)] == [True, False]
