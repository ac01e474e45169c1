"""The error budget: what is measured replaces what is assumed, angles count by their lever, teaching cancels."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from controller.calibrations.budget import (
    ARM_NEAR_MM,
    HAND_EYE_MM,
    LOCATED_SIGMA,
    OWN_SIGMA,
    assumed_hand_eye_covariance,
    at_lever_mm,
    budget_table,
    parts,
)
from controller.calibrations.record import Calibration, DeviceNames, Kind, basis
from perception.geometry import Pose


def calibration(kind: Kind, sigma_mm: float, sigma_deg: float, port: str | None = None) -> Calibration:
    axes = np.array([sigma_mm / 1e3] * 3 + [np.deg2rad(sigma_deg)] * 3) / np.sqrt(3.0)
    devices = DeviceNames("a", "s")
    return Calibration(kind, Pose.identity(), np.diag(axes**2), devices, datetime(2026, 1, 1, tzinfo=UTC), port=port)


def test_an_angle_counts_by_its_lever() -> None:
    assert at_lever_mm(calibration("hand-eye", 0.0, 0.2), 200.0) == pytest.approx(0.70, abs=0.01)
    assert at_lever_mm(calibration("hand-eye", 0.3, 0.0), 200.0) == pytest.approx(0.3)


def test_what_is_measured_replaces_what_is_assumed_and_teaching_cancels_it() -> None:
    assumed = {part.name: part for part in parts({}, 290.0)}
    measured = {part.name: part for part in parts({"hand-eye": calibration("hand-eye", 0.1, 0.02)}, 290.0)}
    assert measured["hand-eye"].untaught_mm == pytest.approx(np.hypot(0.1, 0.1012), abs=0.001)
    assert measured["hand-eye"].untaught_mm < assumed["hand-eye"].untaught_mm
    assert measured["hand-eye"].taught_mm == 0.0
    taught = {part.name: part for part in parts({"port-ccs2": calibration("port", 0.08, 0.0, "ccs2")}, 290.0)}
    assert taught["teaching"].taught_mm == pytest.approx(0.08)


def test_a_mounting_that_was_solved_with_the_arm_counts_by_what_both_leave_uncertain_of_a_port() -> None:
    solved = replace(calibration("hand-eye", 0.3, 0.1), arm_errors=np.zeros(19), residuals=((LOCATED_SIGMA, 0.34),))
    found = {part.name: part for part in parts({"hand-eye": solved}, 290.0)}
    assert (found["hand-eye"].untaught_mm, found["arm"].untaught_mm) == (0.34, ARM_NEAR_MM)


def test_the_table_ends_with_the_root_of_the_sum_of_squares() -> None:
    *_, last = budget_table({"hand-eye": calibration("hand-eye", 0.4, 0.0)}, 290.0)
    assert f"| all | {np.sqrt(0.05**2 + 0.4**2 + 0.5**2 + 0.2**2):.2f} |" in last


def test_a_tool_found_by_mating_has_its_hand_eyes_error_in_it_and_not_that_of_another() -> None:
    mounting = calibration("hand-eye", 0.4, 0.1)
    mated = replace(calibration("tool", 0.6, 0.1), made_with=basis(mounting, None), residuals=((OWN_SIGMA, 0.15),))
    together = {part.name: part.untaught_mm for part in parts({"hand-eye": mounting, "tool": mated}, 290.0)}
    assert (together["hand-eye"], together["tool"]) == (0.0, 0.15)
    touched = {part.name: part for part in parts({"hand-eye": mounting, "tool": calibration("tool", 0.1, 0.1)}, 290.0)}
    assert touched["hand-eye"].untaught_mm > 0.4
    assert touched["tool"].untaught_mm == pytest.approx(0.1)


def test_the_assumed_mounting_is_as_uncertain_at_the_port_as_the_budget_assumes() -> None:
    devices = DeviceNames("a", "s")
    covariance = assumed_hand_eye_covariance(290.0)
    assumed = Calibration("hand-eye", Pose.identity(), covariance, devices, datetime(2026, 1, 1, tzinfo=UTC))
    assert at_lever_mm(assumed, 290.0) == pytest.approx(HAND_EYE_MM)
