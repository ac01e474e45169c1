"""What a dry run meets: the true world of each scenario, drawn from a seed. The controller never sees these values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controller.config import SiteConfig
from controller.config_section import ConfigError
from perception.geometry import Pose
from perception.port_shape import PortDescription

HAND_EYE_M, HAND_EYE_DEG = 0.0002, 0.03
TOOL_M, TOOL_DEG = 0.0001, 0.03
JOINT_RAD = 0.0001
"""1 sigma of each axis of a good calibration's remaining errors: about 0.4 mm of hand-eye, 0.2 mm of tool and 0.2 mm of
arm at the port."""


@dataclass(frozen=True, slots=True, eq=False)
class Miscalibration:
    """What the site's calibration does not know: how the true cell differs from the configured one."""

    scanner: Pose
    """True scanner in the configured scanner's frame."""
    tool: Pose
    """True TCP in the configured TCP's frame."""
    joints: tuple[float, float, float, float, float, float]
    """True joint angles minus those that the arm reports, rad."""


NONE = Miscalibration(Pose.identity(), Pose.identity(), (0.0,) * 6)


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """What is true, and what is in the way."""

    name: str
    T_base_port: Pose
    plain_panel: bool = False
    glare_until_sweep: int = 0
    blocked_depth_m: float | None = None
    miscalibration: Miscalibration = NONE


SCENARIOS = ("nominal", "no-port", "first-scan-poor", "blocked")
BLOCKED_DEPTH_M = 0.008


def draw_scenario(name: str, config: SiteConfig, port: PortDescription, seed: int) -> Scenario:
    """The scenario's world: the car stands up to 20 mm, 4 deg off, the calibration is good but not perfect.

    Raises ConfigError for an unknown name.
    """
    if name not in SCENARIOS:
        raise ConfigError(f"no scenario is called '{name}'", remedy=f"Use one of {', '.join(SCENARIOS)}.")
    rng = np.random.default_rng([seed, 1])
    offset_m = rng.uniform(-1.0, 1.0, 3) * [0.020, 0.015, 0.015]
    turn_rad = np.deg2rad(rng.uniform(-1.0, 1.0, 3) * [4.0, 4.0, 3.0])
    T_base_port = config.port.T_base_port.pose @ Pose.from_rotvec(turn_rad, offset_m)
    nominal = Scenario(name, T_base_port, miscalibration=_draw_miscalibration(np.random.default_rng([seed, 2])))
    match name:
        case "no-port":
            return replace(nominal, plain_panel=True)
        case "first-scan-poor":
            return replace(nominal, glare_until_sweep=1)
        case "blocked":
            return replace(nominal, blocked_depth_m=min(BLOCKED_DEPTH_M, port.mated_depth_m / 2.0))
        case _:
            return nominal


def _draw_miscalibration(rng: np.random.Generator) -> Miscalibration:
    def pose(sigma_m: float, sigma_deg: float) -> Pose:
        return Pose.from_rotvec(np.deg2rad(rng.normal(0.0, sigma_deg, 3)), rng.normal(0.0, sigma_m, 3))

    j1, j2, j3, j4, j5, j6 = rng.normal(0.0, JOINT_RAD, 6).tolist()
    return Miscalibration(pose(HAND_EYE_M, HAND_EYE_DEG), pose(TOOL_M, TOOL_DEG), (j1, j2, j3, j4, j5, j6))
