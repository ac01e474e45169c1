"""The error budget at the plug: what each link of the chain adds, with teaching and without. Pure.

Parts add as independent errors do (root of the sum of squares). An angle counts by its lever: the scanner's stand-off.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from controller.calibrations.record import Calibration, fits_basis
from perception.geometry import Array

LOCATOR_MM = 0.05
"""Of one good scan, as `portdock evaluate locate` finds it."""
ARM_MM = 0.5
"""Of an arm that was not calibrated itself, over its reach; assumed."""
ARM_NEAR_MM = 0.1
"""What of it differs between the taught place and a car that stands elsewhere, or between scanning and docking with an
arm whose errors were estimated; assumed."""
HAND_EYE_MM = 0.7
"""Of a scanner that was mounted by measure and not calibrated by sweeps; assumed."""
TOOL_MM = 0.2
"""Of a tool frame from its drawing; assumed."""
TURN_DEG = 0.3
"""1 sigma, each axis, of a rotation that the site file or a port's description says; assumed."""
LOCATED_SIGMA = "located_sigma_mm"
"""Residual of a hand-eye calibration that estimated the arm's errors: 1 sigma of a port's place, arm and mounting
together."""
OWN_SIGMA = "own_sigma_mm"
"""Residual of a tool found by mating: its 1 sigma without the hand-eye calibration's part."""


@dataclass(frozen=True, slots=True)
class Part:
    """One link of the chain, 1 sigma at the plug."""

    name: str
    untaught_mm: float
    taught_mm: float
    source: str


def parts(calibrations: Mapping[str, Calibration], standoff_mm: float) -> tuple[Part, ...]:
    """The links in their order. ``calibrations`` by slot."""
    hand_eye, tool = calibrations.get("hand-eye"), calibrations.get("tool")
    taught = next((one for slot, one in calibrations.items() if slot.startswith("port-")), None)
    teaching_mm = 0.0 if taught is None else taught.sigma_mm
    return (
        Part("locator", LOCATOR_MM, LOCATOR_MM, "evaluate locate"),
        _hand_eye_part(hand_eye, tool, standoff_mm),
        Part("arm", ARM_MM if hand_eye is None or hand_eye.arm_errors is None else ARM_NEAR_MM, ARM_NEAR_MM, "assumed"),
        _tool_part(tool),
        Part("teaching", 0.0, teaching_mm, "not taught" if taught is None else "its spread"),
    )


def _hand_eye_part(hand_eye: Calibration | None, tool: Calibration | None, standoff_mm: float) -> Part:
    """A tool that was found by mating has the mounting's error in it, with the other sign."""
    if tool is not None and tool.made_with is not None and fits_basis(tool.made_with, hand_eye, None):
        return Part("hand-eye", 0.0, 0.0, "in the tool that was found with it")
    if hand_eye is None:
        return Part("hand-eye", HAND_EYE_MM, 0.0, "assumed")
    if (located_mm := dict(hand_eye.residuals).get(LOCATED_SIGMA)) is not None:
        return Part("hand-eye", located_mm, 0.0, "its covariance, the arm's where it scans too")
    return Part("hand-eye", at_lever_mm(hand_eye, standoff_mm), 0.0, "its covariance")


def _tool_part(tool: Calibration | None) -> Part:
    if tool is None:
        return Part("tool", TOOL_MM, 0.0, "assumed")
    if tool.made_with is None:
        return Part("tool", tool.sigma_mm, 0.0, "its covariance")
    return Part("tool", dict(tool.residuals)[OWN_SIGMA], 0.0, "its spread and the plug's play")


def assumed_hand_eye_covariance(standoff_mm: float) -> Array:
    """(6, 6) of a mounting that was not calibrated: half of ``HAND_EYE_MM`` squared from place, half from rotation."""
    axis_m = 1e-3 * HAND_EYE_MM / np.sqrt(6.0)
    return np.diag([axis_m] * 3 + [axis_m / (1e-3 * standoff_mm)] * 3) ** 2


def at_lever_mm(hand_eye: Calibration, standoff_mm: float) -> float:
    """1 sigma of a mounting where the port is: position, and rotation times the stand-off."""
    return float(np.hypot(hand_eye.sigma_mm, np.deg2rad(hand_eye.sigma_deg) * standoff_mm))


def budget_table(calibrations: Mapping[str, Calibration], standoff_mm: float) -> Iterator[str]:
    """Markdown, line by line."""
    found = parts(calibrations, standoff_mm)
    yield "| part | 1 sigma (mm) | after teaching (mm) | from |"
    yield "|---|---|---|---|"
    for part in found:
        yield f"| {part.name} | {part.untaught_mm:.2f} | {part.taught_mm:.2f} | {part.source} |"
    total = np.sqrt(np.sum([[part.untaught_mm**2, part.taught_mm**2] for part in found], axis=0))
    yield f"| all | {total[0]:.2f} | {total[1]:.2f} | root of the sum of squares |"
