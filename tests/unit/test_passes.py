"""The sweep plan: as many parallel passes as port, window and overlap need, and the strip they see has no gap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.config import ScanConfig, ViewpointConfig, load_config
from controller.looking import plan_view
from controller.passes import pass_offsets_m, plan_passes, port_width_m
from controller.planning import FACING
from controller.port_files import bundled_ports, load_port
from perception.geometry import Pose


@given(st.floats(0.01, 0.3), st.floats(0.005, 0.3), st.floats(0.05, 0.6))
def test_the_strip_is_seen_from_edge_to_edge_with_the_overlap_asked_for(
    width: float, window: float, share: float
) -> None:
    middles = np.array(pass_offsets_m(width, window, share))
    if window >= width:
        assert middles.tolist() == [0.0]
        return
    assert middles[0] - window / 2 == pytest.approx(-width / 2)
    assert middles[-1] + window / 2 == pytest.approx(width / 2)
    assert np.diff(middles).max() <= window * (1 - share) + 1e-9
    fewer = (width - window) / max(1, len(middles) - 2) if len(middles) > 2 else width
    assert fewer > window * (1 - share) - 1e-9, "one pass fewer would do"


def test_a_30_mm_window_takes_six_passes_over_a_ccs2_and_a_wide_one_takes_one() -> None:
    assert len(plan_view(load_config(scanner="profiler2"), 0)) == 6
    assert len(plan_view(load_config(), 0)) == 1


def test_passes_go_down_and_up_in_turn_and_look_at_the_port() -> None:
    scan = ScanConfig(standoff_mm=100.0, length_mm=100.0, width_mm=78.0, overlap_percent=20.0, centre_mm=(5.0, -20.0))
    hand_eye, T_flange_tcp = Pose.from_vector([0, -0.1, 0.1, 0, 0, 0]), Pose.from_vector([0, 0, 0.2, 0, 0, 0])
    shape = load_port("ccs2").shape
    passes = plan_passes(Pose.identity(), ViewpointConfig(), scan, shape, 0.03, hand_eye, T_flange_tcp)
    assert len(passes) == 3
    T_tcp_scanner = T_flange_tcp.inverse() @ hand_eye
    for number, view in enumerate(passes):
        start, end = view.T_base_tcp_start @ T_tcp_scanner, view.T_base_tcp_end @ T_tcp_scanner
        np.testing.assert_allclose(start.rotation, FACING, atol=1e-9)
        x = 0.005 + 0.024 * (number - 1)
        ends = np.array([[x, 0.03, 0.1], [x, -0.07, 0.1]])
        np.testing.assert_allclose(
            [start.translation, end.translation], ends if number % 2 == 0 else ends[::-1], atol=1e-9
        )


@pytest.mark.parametrize("port", bundled_ports())
def test_every_bundled_port_has_a_width_that_fits_its_rim(port: str) -> None:
    assert 0.03 < port_width_m(load_port(port).shape) < 0.2
