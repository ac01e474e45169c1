"""How well a scanner can locate a port, predicted from its noise model before anything moves. Pure.

A deliberately simple bound: noise averages out over the points on the rim's face and walls, what neighbouring points
share does not, and an edge is found to a part of the spacing of the points. It decides nothing about a scan that was
made (the locator's own covariance does); it tells a scanner that can dock from one that cannot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.config import ScanConfig, SiteConfig
from controller.config_section import ConfigError
from controller.passes import port_width_m
from controller.port_files import load_port
from controller.scanner_facts import ScannerFacts, scanner_facts
from perception.outline import outline_bounds
from perception.port_model import AcceptanceLimits
from perception.port_shape import PortShape

USED_SHARE = 0.2
"""Of the points on the port: those that lie on surfaces which fix the pose in one given direction."""
POINTS_A_LINE = 200
PROFILE_RATE_HZ = 20.0
"""Of a slow device; the systematic part decides anyway."""


class ScannerTooCoarseError(ConfigError):
    """The configured scanner cannot locate a port as well as docking needs (exit code 2)."""

    code = "scanner-too-coarse"
    default_remedy = (
        "Dock with a triangulating profiler (scanner.protocol framed or profiler2);"
        " this one may look first: coarse.scanner."
    )


@dataclass(frozen=True, slots=True)
class Prediction:
    """1 sigma of the port's pose."""

    translation_m: float
    rotation_rad: float


def predict(facts: ScannerFacts, scan: ScanConfig, shape: PortShape) -> Prediction:
    """What a sweep with this scanner over this port can give at best."""
    low_x, low_y, high_x, high_y = outline_bounds(shape.rim)
    width_m, height_m = high_x - low_x, high_y - low_y
    lines = max(1.0, height_m / (scan.speed_mm_s / 1000.0 / PROFILE_RATE_HZ))
    points = max(1.0, USED_SHARE * lines * POINTS_A_LINE * min(1.0, width_m / facts.window_m))
    averaged_m = facts.noise_m / np.sqrt(points)
    translation_m = float(np.sqrt(3.0 * (averaged_m**2 + facts.systematic_m**2)))
    lever_m = float(np.hypot(width_m, height_m)) / 2.0
    return Prediction(translation_m, float(np.hypot(averaged_m, facts.systematic_m)) / lever_m)


def refuse_too_coarse(config: SiteConfig) -> None:
    """Raise ScannerTooCoarseError where the predicted pose uncertainty exceeds what a port's acceptance allows."""
    facts, limits = scanner_facts(config.scanner), AcceptanceLimits()
    shape = load_port(config.port.model).shape
    found = predict(facts, config.scan, shape)
    if found.translation_m <= limits.max_translation_sigma_m and found.rotation_rad <= limits.max_rotation_sigma_rad:
        return
    raise ScannerTooCoarseError(
        f"{facts.title} alone cannot dock: its noise model predicts a port pose good to"
        f" {found.translation_m * 1e3:.1f} mm and {np.rad2deg(found.rotation_rad):.1f} deg (1 sigma) on a port"
        f" {port_width_m(shape) * 1e3:.0f} mm wide; docking allows {limits.max_translation_sigma_m * 1e3:.2f} mm"
        f" and {np.rad2deg(limits.max_rotation_sigma_rad):.2f} deg"
    )
