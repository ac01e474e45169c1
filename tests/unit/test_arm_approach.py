"""The check of a whole approach: as configured, with what stands around the arm and what was seen in the scene."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from controller.config import ConfigError, SiteConfig, load_config
from controller.planning import FACING, plan_on_axis
from controller.port_files import load_port
from controller.wiring import build_devices, reach_check
from drivers.arm.kinematics import MODELS, JointLimits, nearest_branch
from drivers.base import ArmState, Box, MonotonicClock, NullSink, RobotMode, SafetyMode
from perception.geometry import Pose

SEED = np.array([2.8, -1.8, 1.8, -0.2, 1.5, 2.9])


class StillArm:
    """Stands where the approach of the bundled site begins."""

    def __init__(self, config: SiteConfig) -> None:
        self.obstacles: tuple[Box, ...] = ()
        tcp = config.arm.T_flange_tcp.pose
        T_base_tcp = config.port.T_base_port.pose @ Pose(FACING, np.array([0.0, 0.0, 0.3]))
        joints = nearest_branch(MODELS[config.arm.model], T_base_tcp @ tcp.inverse(), SEED, JointLimits.symmetric())
        assert joints is not None
        none = np.zeros(6)
        mode, safety = RobotMode.RUNNING, SafetyMode.NORMAL
        self._state = ArmState(0.0, 0.0, T_base_tcp, tcp, joints, none, none, mode, safety, False, True, 1.0)

    def state(self) -> ArmState:
        return self._state


def approach(config: SiteConfig) -> list[Pose]:
    plan = plan_on_axis(config.port.T_base_port.pose, load_port(config.port.model).T_port_tcp, config.motion)
    return [plan.retreat, plan.pre_contact, plan.mated]


def site(tmp_path: Path, text: str) -> SiteConfig:
    (tmp_path / "site.yaml").write_text(text)
    return load_config(tmp_path / "site.yaml")


def why_not(config: SiteConfig, *seen: Box) -> str | None:
    arm = StillArm(config)
    arm.obstacles = seen
    return reach_check(config, arm)(approach(config))  # type: ignore[arg-type]


def test_the_bundled_sites_approach_is_free() -> None:
    assert why_not(load_config()) is None


def test_a_configured_box_in_the_way_is_named(tmp_path: Path) -> None:
    box = "{name: bollard, size_mm: [60, 60, 400], T_base_box: {xyz_mm: [800, 100, 400]}}"
    assert "bollard" in (why_not(site(tmp_path, f"arm: {{boxes: [{box}]}}")) or "")


def test_a_box_aside_is_no_reason(tmp_path: Path) -> None:
    box = "{name: post, size_mm: [60, 60, 400], T_base_box: {xyz_mm: [800, 900, 400]}}"
    assert why_not(site(tmp_path, f"arm: {{boxes: [{box}]}}")) is None


def test_an_open_cover_seen_in_the_scan_is_kept_clear_of() -> None:
    config = load_config()
    before_port = config.port.T_base_port.pose @ Pose(np.eye(3), np.array([0.0, 0.06, 0.1]))
    assert "tool and cover" in (why_not(config, Box("cover", before_port, (0.05, 0.05, 0.005))) or "")


def test_the_plug_may_touch_the_panel_but_the_wrist_may_not() -> None:
    config = load_config()
    panel = config.port.T_base_port.pose
    thin, thick = (Box("panel", panel, (0.5, 0.5, half), tool_may_touch=True) for half in (0.001, 0.17))
    assert why_not(config, thin) is None
    assert "wrist 3 and panel" in (why_not(config, thick) or "")


def test_joint_ranges_of_the_site_hold(tmp_path: Path) -> None:
    config = site(tmp_path, "arm: {joint_max_deg: [360, 360, 360, 360, 360, 100]}")
    assert "joint 6" in (why_not(config) or "")


def test_clearance_beyond_touching_can_be_asked_for(tmp_path: Path) -> None:
    config = load_config()
    beside = config.port.T_base_port.pose @ Pose(np.eye(3), np.array([0.14, 0.0, 0.1]))
    cover = Box("cover", beside, (0.02, 0.02, 0.02))
    assert why_not(config, cover) is None
    assert "cover" in (why_not(site(tmp_path, "arm: {least_clearance_mm: 100}"), cover) or "")


def test_the_driver_is_built_with_what_the_site_says(tmp_path: Path) -> None:
    text = """arm:
  boxes: [{name: wall, size_mm: [10, 20, 30], tool_may_touch: true}]
  stop_running_program: true
  upper_registers: true
  tool_radius_mm: 70
"""
    settings = build_devices(site(tmp_path, text), NullSink(), MonotonicClock()).arm._settings  # type: ignore[attr-defined]
    assert (settings.boxes[0].name, settings.boxes[0].half_size) == ("wall", (0.005, 0.01, 0.015))
    assert settings.boxes[0].tool_may_touch and settings.stop_running_program and settings.upper_registers
    assert settings.tool.radius == pytest.approx(0.07)


@pytest.mark.parametrize("box", ["{name: a, size_mm: [0, 1, 1]}", "{size_mm: [1, 1, 1]}", "{name: a, size_mm: [1, 1]}"])
def test_a_box_without_name_or_size_is_refused(tmp_path: Path, box: str) -> None:
    with pytest.raises(ConfigError, match="boxes"):
        site(tmp_path, f"arm: {{boxes: [{box}]}}")


def test_a_whole_approach_is_checked_within_milliseconds() -> None:
    config = load_config()
    arm, poses = StillArm(config), approach(config)
    arm.obstacles = tuple(Box(f"box {k}", Pose(np.eye(3), np.array([2.0, k, 0.0])), (0.3, 0.3, 0.3)) for k in range(3))
    check = reach_check(config, arm)  # type: ignore[arg-type]
    check(poses)
    times = []
    for _ in range(10):
        begin = time.process_time()
        assert check(poses) is None
        times.append(time.process_time() - begin)
    assert min(times) < 0.02
