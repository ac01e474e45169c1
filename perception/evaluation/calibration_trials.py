"""How good calibration and teaching are, in numbers over many drawn cells; and how the drift chart warns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.calibration.drift import ChartSettings, Dock, chart
from perception.calibration.teaching import teach
from perception.evaluation.calibration_cells import (
    JOINT_RAD,
    LINK_M,
    SPEED_M_S,
    TrueCell,
    draw_cell,
    with_all_errors,
)
from perception.evaluation.calibration_controller import (
    CENTRE,
    T_FLANGE_TCP,
    T_PORT_TCP,
    Known,
    calibrated_with_arm,
    square_on,
)
from perception.geometry import Array, Pose, exp

LOCATOR_M, LOCATOR_RAD = 0.00005, float(np.deg2rad(0.03))
"""1 sigma of each axis of the locator, assumed: 0.05 mm or less is what `evaluate locate` finds of one good scan."""
CAR_M, CAR_RAD = 0.100, float(np.deg2rad(10.0))
"""How far the car stands from where the port was taught, each axis."""
CARS = 10
"""Car positions for each cell."""
MATED_M, MATED_RAD = 0.00005, float(np.deg2rad(0.02))
"""1 sigma of how a plug sits in its port, from dock to dock."""


CAPTURE_M, CAPTURE_RAD = 0.001, float(np.deg2rad(1.0))
"""What a CCS2 inlet takes up (config/ports/ccs2.yaml)."""


@dataclass(frozen=True, slots=True)
class HandEyeTrial:
    """One calibration of one cell with a perfect arm that is taken at its word."""

    error_mm: float
    error_deg: float
    inside_95: bool
    """The true mounting lies in the stated 95 % ellipsoid."""
    with_arm_mm: float
    """Error of the position where the arm's errors are estimated all the same."""


@dataclass(frozen=True, slots=True)
class Placed:
    """Where the true plug is when the arm has brought it to where it would mate."""

    off_mm: float
    """Distance from its mated place."""
    captured: bool
    """Within what the port takes up of a plug that comes sideways and tilted: it docks at the first try."""


@dataclass(frozen=True, slots=True)
class PlacingTrial:
    """One car at one cell whose arm errs: after hand-eye calibration, and after teaching on top."""

    located_mm: float
    stated_mm: float
    """1 sigma of that, as the calibration states it."""
    located_ideal_mm: float
    """The same by a calibration that takes the arm at its word."""
    inside_95: bool
    """The cell's true mounting lies in the stated 95 % ellipsoid."""
    untaught: Placed
    taught: Placed


def hand_eye_trial(seed: int) -> HandEyeTrial:
    """A cell with a perfect arm, calibrated from a guess up to 20 mm and 10 deg off."""
    rng = np.random.default_rng([seed, 1])
    cell = draw_cell(rng)
    true, known = cell.T_flange_scanner, calibrated_with_arm(cell, rng)
    found = known.ideal.mounting.T_flange_scanner
    with_arm_mm = 1e3 * true.distance_to(known.mounting.T_flange_scanner)
    inside = known.holds_at_its_word(true)
    return HandEyeTrial(1e3 * true.distance_to(found), float(np.rad2deg(true.angle_to(found))), inside, with_arm_mm)


def placing_trials(seed: int, everything: bool = False) -> list[PlacingTrial]:
    """A cell whose arm errs: calibrated, taught at one place, docked at cars that stand elsewhere.

    :param everything: with gravity's sag and a scanner's clock that is off, beside errors of zeros and lengths
    """
    rng = np.random.default_rng([seed, 2])
    cell = draw_cell(rng, JOINT_RAD, LINK_M)
    if everything:
        cell = with_all_errors(cell, rng)
    known = calibrated_with_arm(cell, rng)
    home = Pose(_PORT_AXES, CENTRE)
    views = [np.zeros(3), np.deg2rad([12.0, 0.0, 0.0]), np.zeros(3)]
    scans = [located(cell, home, known, view, rng) for view in views]
    taught = teach(scans, known.tcp(told_when_mated(cell, home, rng))).T_port_tcp
    trials = []
    for _ in range(CARS):
        moved = Pose.from_rotvec(rng.uniform(-CAR_RAD, CAR_RAD, 3), rng.uniform(-CAR_M, CAR_M, 3))
        T_base_port = Pose(home.rotation @ moved.rotation, home.translation + moved.translation)
        seen = located(cell, T_base_port, known, np.zeros(3), rng)
        ideal = located(cell, T_base_port, known.ideal, np.zeros(3), rng)
        placed = [plug_placed(cell, T_base_port, known.told(seen @ mated)) for mated in (T_PORT_TCP, taught)]
        off_mm, ideal_mm = (1e3 * one.distance_to(T_base_port) for one in (seen, ideal))
        stated_mm, inside = 1e3 * known.located_sigma_m(T_base_port), known.holds(cell.T_flange_scanner)
        trials.append(PlacingTrial(off_mm, stated_mm, ideal_mm, inside, *placed))
    return trials


_PORT_AXES = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""A port that looks at the robot: z along the base's -x, y up."""


def located(cell: TrueCell, T_base_port: Pose, known: Known, view_rad: Array, rng: np.random.Generator) -> Pose:
    """T_base_port as arm, calibration and locator say: the scanner looks squarely at it, but for the view's tilt."""
    late_s = cell.time_offset_s - known.mounting.time_offset_s
    T_flange_scanner = known.mounting.T_flange_scanner.moved([0.0, -SPEED_M_S * late_s, 0.0])
    told = square_on(T_base_port, view_rad, T_flange_scanner)
    true = cell.true_flange(told)
    T_scanner_port = (true @ cell.T_flange_scanner).inverse() @ T_base_port
    noise = exp(np.concatenate([rng.normal(0, LOCATOR_M, 3), rng.normal(0, LOCATOR_RAD, 3)]))
    return known.flange(told) @ T_flange_scanner @ T_scanner_port @ noise


def told_when_mated(cell: TrueCell, T_base_port: Pose, rng: np.random.Generator) -> Pose:
    """T_base_tcp that the arm says while the plug is home: its nominal tool, its own kinematics' errors."""
    sits = exp(np.concatenate([rng.normal(0, MATED_M, 3), rng.normal(0, MATED_RAD, 3)]))
    wanted = T_base_port @ T_PORT_TCP @ sits @ cell.T_flange_tcp.inverse()
    told = wanted
    for _ in range(4):  # the told flange pose whose true pose is the wanted one
        told = told @ (cell.true_flange(told).inverse() @ wanted)
    return told @ T_FLANGE_TCP


def plug_placed(cell: TrueCell, T_base_port: Pose, T_base_tcp: Pose) -> Placed:
    """Where the true plug is when the arm is told to bring its TCP to ``T_base_tcp``."""
    plug = T_base_port.inverse() @ cell.true_flange(T_base_tcp @ T_FLANGE_TCP.inverse()) @ cell.T_flange_tcp
    sideways_m = float(np.linalg.norm((plug.translation - T_PORT_TCP.translation)[:2]))
    captured = sideways_m <= CAPTURE_M and plug.angle_to(T_PORT_TCP) <= CAPTURE_RAD
    return Placed(1e3 * plug.distance_to(T_PORT_TCP), captured)


# --- drift ------------------------------------------------------------------------------------------------------------

DOCK_M, DOCK_RAD = 0.00015, float(np.deg2rad(0.08))
"""1 sigma of each axis of a dock's offset while nothing changes."""
BUMP_M, BUMP_RAD = 0.0005, float(np.deg2rad(0.3))
GOOD_DOCKS = 500


@dataclass(frozen=True, slots=True)
class DriftTrial:
    """One cell's chart."""

    false_alarm: bool
    """In 500 good docks after the standard."""
    docks_to_warning: int | None
    """After a bump; None: not within 50."""


def drift_trial(seed: int) -> DriftTrial:
    """500 good docks, then a scanner that was knocked by 0.5 mm and 0.3 deg in some direction."""
    rng = np.random.default_rng([seed, 3])
    sigma = np.array([DOCK_M] * 3 + [DOCK_RAD] * 3)
    place, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    bump = np.concatenate([BUMP_M * place, BUMP_RAD * axis])
    good, after = ChartSettings().baseline + GOOD_DOCKS, 50
    constant = rng.normal(0, 3, 6) * sigma
    offsets = constant + rng.normal(size=(good + after, 6)) * sigma
    offsets[good:] += bump
    found = chart([Dock("ccs2", offset) for offset in offsets])
    assert found is not None, "there are docks enough"
    alarms = found.alarms
    warned = np.flatnonzero(alarms[GOOD_DOCKS:])
    return DriftTrial(bool(alarms[:GOOD_DOCKS].any()), int(warned[0]) + 1 if len(warned) else None)
