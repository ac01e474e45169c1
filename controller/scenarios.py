"""What a dry run meets: the true world of each scenario, drawn from a seed. The controller never sees these values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from controller.config import SiteConfig
from controller.config_section import ConfigError
from controller.mock_calibrations import CELL, is_kept
from perception.geometry import Array, Pose
from perception.port_shape import PortDescription

HAND_EYE_M, HAND_EYE_DEG = 0.0002, 0.03
TOOL_M, TOOL_DEG = 0.0001, 0.03
JOINT_RAD = 0.0001
"""1 sigma of each axis of a good calibration's remaining errors: about 0.4 mm of hand-eye, 0.2 mm of tool and 0.3 mm of
arm at the port. Most of the arm's is the same where it scans and where it docks."""
LINK_M = 0.0002
"""No length of the arm is farther off its drawing, in no scenario."""


@dataclass(frozen=True, slots=True, eq=False)
class Miscalibration:
    """What the site's calibration does not know: how the true cell differs from the configured one."""

    scanner: Pose
    """True scanner in the configured scanner's frame."""
    tool: Pose
    """True TCP in the configured TCP's frame."""
    joints: tuple[float, float, float, float, float, float]
    """True joint angles minus those that the arm reports, rad."""
    links_m: tuple[float, float, float, float, float, float] = (0.0,) * 6
    """True lengths of the arm (d1, a2, a3, d4, d5, d6) minus those that it computes with."""
    compliance_rad_per_nm: float = 0.0
    """Of each joint under the weight that it carries."""
    latency_s: float = 0.0
    """Profiles were measured so much earlier than stamp or arrival say, beyond what the scanner's data tell."""


NONE = Miscalibration(Pose.identity(), Pose.identity(), (0.0,) * 6)


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """What is true, and what is in the way."""

    name: str
    T_base_port: Pose
    plain_panel: bool = False
    target: Literal["sphere", "corner"] | None = None
    """A calibration target in the vehicle's place."""
    sphere_radius_m: float = 0.0254
    glare_until_sweep: int = 0
    blocked_depth_m: float | None = None
    miscalibration: Miscalibration = NONE
    calibrated: bool = False
    """The cell is the one whose calibrations are kept with portdock (``mock_calibrations``)."""


COMPLIANCE_RAD_PER_NM = 3e-6
"""An arm of 1.3 m reach hangs some tenths of a millimetre lower at the port than it says, half as much or half as much
again from cell to cell."""
UNCALIBRATED_M, UNCALIBRATED_DEG = (0.010, 0.020), (5.0, 10.0)
"""How far a scanner that was mounted by eye and tape measure sits off its nominal place."""
UNCALIBRATED_LATENCY_S = 0.005
UNCALIBRATED_JOINT_DEG = 0.02
"""No joint zero is farther off: with the lengths the arm is some 0.5 mm off at the port."""

SCENARIOS = ("nominal", "no-port", "first-scan-poor", "blocked", "uncalibrated")
BLOCKED_DEPTH_M = 0.008


def draw_scenario(name: str, config: SiteConfig, port: PortDescription, seed: int, cell: int | None = None) -> Scenario:
    """The scenario's world: the car stands up to 20 mm, 4 deg off.

    Before a site with a coarse stage it stands farther off: up to 60 % of what that stage is to bridge.

    ``uncalibrated``: the scanner sits 10 to 20 mm and 5 to 10 deg off its nominal place, its clock is up to 5 ms late,
    joints are up to 0.02 deg off, the tool some tenths of a millimetre. All others: where the site is built as the
    bundled one, such a cell that was calibrated (``mock_calibrations``); else, and where a ``cell`` is named, one of
    which only the errors are known that a good calibration leaves. The arm's lengths are up to 0.2 mm off in every one.

    ``cell``: which cell, where that is not the seed: its calibration errors stay while the car comes and goes.

    Raises ConfigError for an unknown name.
    """
    check_name(name)
    T_base_port = draw_parking(config, np.random.default_rng([seed, 1]))
    kept = is_kept(config, name, cell)
    number = CELL if kept else seed if cell is None else cell
    drawn = _draw_uncalibrated if kept or name == "uncalibrated" else _draw_miscalibration
    nominal = Scenario(name, T_base_port, miscalibration=drawn(np.random.default_rng([number, 2])), calibrated=kept)
    match name:
        case "no-port":
            return replace(nominal, plain_panel=True)
        case "first-scan-poor":
            return replace(nominal, glare_until_sweep=1)
        case "blocked":
            return replace(nominal, blocked_depth_m=min(BLOCKED_DEPTH_M, port.mated_depth_m / 2.0))
        case _:
            return nominal


def draw_parking(config: SiteConfig, rng: np.random.Generator) -> Pose:
    """T_base_port of a car that has just parked."""
    offset_m = rng.uniform(-1.0, 1.0, 3) * _parking_m(config)
    turn_rad = np.deg2rad(rng.uniform(-1.0, 1.0, 3) * [4.0, 4.0, 3.0])
    return config.port.T_base_port.pose @ Pose.from_rotvec(turn_rad, offset_m)


def check_name(scenario: str) -> None:
    """Raises ConfigError for an unknown one."""
    if scenario not in SCENARIOS:
        raise ConfigError(f"no scenario is called '{scenario}'", remedy=f"Use one of {', '.join(SCENARIOS)}.")


def _parking_m(config: SiteConfig) -> Array:
    """How far the car stands off its place at most, along each axis (3,) of the port."""
    if config.coarse is None:
        return np.array([0.020, 0.015, 0.015])
    lateral_mm = config.coarse.lateral_mm / np.sqrt(2.0)
    return 0.6e-3 * np.array([lateral_mm, lateral_mm, config.coarse.along_mm])


def _draw_miscalibration(rng: np.random.Generator) -> Miscalibration:
    def pose(sigma_m: float, sigma_deg: float) -> Pose:
        return Pose.from_rotvec(np.deg2rad(rng.normal(0.0, sigma_deg, 3)), rng.normal(0.0, sigma_m, 3))

    j1, j2, j3, j4, j5, j6 = rng.normal(0.0, JOINT_RAD, 6).tolist()
    scanner, tool = pose(HAND_EYE_M, HAND_EYE_DEG), pose(TOOL_M, TOOL_DEG)
    return _with_arm(Miscalibration(scanner, tool, (j1, j2, j3, j4, j5, j6)), rng)


def _with_arm(drawn: Miscalibration, rng: np.random.Generator) -> Miscalibration:
    """How much the arm gives, and its lengths as built."""
    give = COMPLIANCE_RAD_PER_NM * float(rng.uniform(0.5, 1.5))
    d1, a2, a3, d4, d5, d6 = rng.uniform(-LINK_M, LINK_M, 6).tolist()
    return replace(drawn, links_m=(d1, a2, a3, d4, d5, d6), compliance_rad_per_nm=give)


def _draw_uncalibrated(rng: np.random.Generator) -> Miscalibration:
    """A cell before its first calibration."""
    place, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    scanner = Pose.from_rotvec(np.deg2rad(rng.uniform(*UNCALIBRATED_DEG)) * turn, rng.uniform(*UNCALIBRATED_M) * place)
    tool = Pose.from_rotvec(np.deg2rad(rng.normal(0.0, TOOL_DEG, 3)), rng.normal(0.0, TOOL_M, 3))
    off_deg = rng.uniform(-UNCALIBRATED_JOINT_DEG, UNCALIBRATED_JOINT_DEG, 6)
    j1, j2, j3, j4, j5, j6 = np.deg2rad(off_deg).tolist()
    drawn = _with_arm(Miscalibration(scanner, tool, (j1, j2, j3, j4, j5, j6)), rng)
    return replace(drawn, latency_s=float(rng.uniform(0.0, UNCALIBRATED_LATENCY_S)))
