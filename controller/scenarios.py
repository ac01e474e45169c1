"""What a dry run meets: the true world of each scenario, drawn from a seed. The controller never sees these values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controller.config import SiteConfig
from controller.config_section import ConfigError
from perception.geometry import Pose
from perception.port_shape import PortDescription


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """What is true, and what is in the way."""

    name: str
    T_base_port: Pose
    plain_panel: bool = False
    glare_until_sweep: int = 0
    blocked_depth_m: float | None = None


SCENARIOS = ("nominal", "no-port", "first-scan-poor", "blocked")
BLOCKED_DEPTH_M = 0.008


def draw_scenario(name: str, config: SiteConfig, port: PortDescription, seed: int) -> Scenario:
    """The scenario's world: the car stands up to 20 mm, 4 deg off. Raises ConfigError for an unknown name."""
    if name not in SCENARIOS:
        raise ConfigError(f"no scenario is called '{name}'", remedy=f"Use one of {', '.join(SCENARIOS)}.")
    rng = np.random.default_rng([seed, 1])
    offset_m = rng.uniform(-1.0, 1.0, 3) * [0.020, 0.015, 0.015]
    turn_rad = np.deg2rad(rng.uniform(-1.0, 1.0, 3) * [4.0, 4.0, 3.0])
    nominal = Scenario(name, config.port.T_base_port.pose @ Pose.from_rotvec(turn_rad, offset_m))
    match name:
        case "no-port":
            return replace(nominal, plain_panel=True)
        case "first-scan-poor":
            return replace(nominal, glare_until_sweep=1)
        case "blocked":
            return replace(nominal, blocked_depth_m=min(BLOCKED_DEPTH_M, port.mated_depth_m / 2.0))
        case _:
            return nominal
