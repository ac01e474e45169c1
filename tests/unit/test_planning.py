"""Viewpoints and docking plans: where the plug goes, in which order, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.config import MotionConfig, ScanConfig, ViewpointConfig, load_config
from controller.planning import FACING, DockPlan, PlanRefusedError, plan_dock, plan_viewpoint
from perception.estimate import PortEstimate
from perception.geometry import Pose

CONFIG = load_config()
PORT = CONFIG.port.T_base_port.pose
MATED = Pose(FACING, np.array([0.0, 0.0, -0.035]))
angles = st.floats(-30, 30)


def estimate(accepted: bool = True, ref: str = "base") -> PortEstimate:
    return PortEstimate(
        port="type2",
        T_ref_port=PORT,
        ref=ref,  # type: ignore[arg-type]
        covariance=np.eye(6) * 1e-9,
        rms_residual_m=1e-4,
        inlier_ratio=0.9,
        runner_up_margin=0.5,
        accepted=accepted,
        reasons=(),
        timings_s=(("total", 0.1),),
    )


def anywhere(_: Sequence[Pose]) -> str | None:
    return None


def plan() -> DockPlan:
    return plan_dock(estimate(), MATED, MotionConfig(), anywhere)


def test_the_plug_goes_in_on_the_ports_axis_from_retreat_to_home() -> None:
    result = plan()
    depths = [result.depth_m(pose) for pose in (result.retreat, result.pre_contact, result.mated)]
    np.testing.assert_allclose(depths, [-0.09, -0.03, 0.035], atol=1e-12)
    for pose in (result.retreat, result.pre_contact, result.mated):
        np.testing.assert_allclose(pose.rotation[:, 2], -PORT.rotation[:, 2], atol=1e-12)
        np.testing.assert_allclose((PORT.inverse() @ pose).translation[:2], 0.0, atol=1e-12)


@pytest.mark.parametrize("bad", [estimate(accepted=False), estimate(ref="scanner")])
def test_an_estimate_that_is_not_accepted_or_not_in_the_base_frame_never_becomes_a_plan(bad: PortEstimate) -> None:
    with pytest.raises(PlanRefusedError):
        plan_dock(bad, MATED, MotionConfig(), anywhere)


def test_the_whole_approach_is_asked_for_reach_in_the_order_of_travel() -> None:
    asked: list[list[float]] = []

    def out_of_reach(poses: Sequence[Pose]) -> str | None:
        asked.append([-float((PORT.inverse() @ pose).translation[2]) for pose in poses])
        return "elbow"

    with pytest.raises(PlanRefusedError, match="elbow"):
        plan_dock(estimate(), MATED, MotionConfig(), out_of_reach)
    np.testing.assert_allclose(asked[0], [-0.09, -0.03, 0.035], atol=1e-12)


@given(angles, angles)
def test_every_viewpoint_looks_at_the_same_spot_from_the_stand_off(pitch_deg: float, yaw_deg: float) -> None:
    T_flange_scanner = CONFIG.scanner.T_flange_scanner.pose
    T_flange_tcp = CONFIG.arm.T_flange_tcp.pose
    scan = ScanConfig(centre_mm=(3.0, -20.0))
    view = plan_viewpoint(
        PORT, ViewpointConfig(pitch_deg=pitch_deg, yaw_deg=yaw_deg), scan, T_flange_scanner, T_flange_tcp
    )
    scanners = [
        pose @ T_flange_tcp.inverse() @ T_flange_scanner for pose in (view.T_base_tcp_start, view.T_base_tcp_end)
    ]
    middle = (scanners[0].translation + scanners[1].translation) / 2
    seen = PORT.inverse().apply(middle + scan.standoff_mm / 1000 * scanners[0].rotation[:, 2])
    np.testing.assert_allclose(seen, [0.003, -0.020, 0.0], atol=1e-12)
    np.testing.assert_allclose(
        scanners[1].translation - scanners[0].translation, scanners[0].rotation[:, 1] * 0.180, atol=1e-12
    )
