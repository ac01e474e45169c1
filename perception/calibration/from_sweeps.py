"""All steps of a hand-eye calibration in their order: sightings, coarse stage, solution, checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from perception.calibration.checks import left_out_errors_m, refuse_moved, refuse_other_size
from perception.calibration.find_planes import COARSE_SCALE_M, find_planes
from perception.calibration.find_port import find_port, port_in_sweep, thinned
from perception.calibration.find_sphere import find_sphere
from perception.calibration.hand_eye import START_SCALE_M, Asked, HandEye, solve
from perception.calibration.sightings import Mounting, Sightings, sightings
from perception.calibration.targets import PortTarget, SphereTarget
from perception.geometry import Array, Pose
from perception.port_model import PortModel
from perception.scan import Scan

POINTS_A_SWEEP = 6000
POINTS_TO_LOCATE = 20_000
"""Of a sweep, for the locator: it looks for edges."""
POINTS_ON_PORT = 20_000
"""Of all sweeps, for the solution."""


@dataclass(frozen=True, slots=True)
class TargetKind:
    """What is swept."""

    name: Literal["sphere", "planes", "port"]
    radius_m: float = 0.0254
    """Of the sphere."""
    port: str = ""
    """Name of the port's model."""


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """A solution with the sightings that it rests on."""

    seen: Sightings
    hand_eye: HandEye

    @property
    def place(self) -> Array | None:
        """(3,) where the target is, base frame; None where it is not one place."""
        target = self.hand_eye.target
        if isinstance(target, PortTarget):
            return target.T_base_port.translation
        return target.centre if isinstance(target, SphereTarget) else None


def solve_sweeps(scans: Sequence[Scan], kind: TargetKind, guess: Mounting, asked: Asked) -> Solved:
    """The mounting from a guess that is up to 20 mm and 10 deg off. Raises CalibrationError."""
    seen = sightings(scans, POINTS_A_SWEEP)
    if kind.name == "sphere":
        found = find_sphere(seen, kind.radius_m, guess)
        on_target = seen.of(found.on_sphere)
        return Solved(on_target, solve(on_target, found.target, found.mounting, asked, START_SCALE_M))
    planes = find_planes(seen, guess, np.random.default_rng(0))
    on_target = seen.of(planes.on_planes)
    return Solved(on_target, solve(on_target, planes.target, guess, asked, COARSE_SCALE_M))


def solve_port_sweeps(
    scans: Sequence[Scan], model: PortModel, T_base_port: Pose, guess: Mounting, asked: Asked
) -> Solved:
    """The same from sweeps of a port that is expected within some centimetres. Raises CalibrationError."""
    seen = sightings(scans, POINTS_TO_LOCATE)
    found = find_port(seen, model, T_base_port, guess)
    on_target = seen.of(thinned(found.on_port, POINTS_ON_PORT))
    return Solved(on_target, solve(on_target, found.target, found.mounting, asked, START_SCALE_M))


def port_place(scan: Scan, model: PortModel, T_base_port: Pose, guess: Mounting) -> Pose:
    """T_base_port as one sweep shows it, as far as the guess tells. Raises CalibrationError."""
    return port_in_sweep(sightings([scan], POINTS_TO_LOCATE), model, T_base_port, guess, 0)


def sphere_place(scan: Scan, radius_m: float, guess: Mounting) -> Array:
    """(3,) where one sweep shows a whole sphere, as far as the guess tells. Raises CalibrationError."""
    found = find_sphere(sightings([scan], POINTS_A_SWEEP), radius_m, guess)
    return np.asarray(found.target.centre)


def checked(solved: Solved, asked: Asked) -> Array:
    """(S,) how far each sweep shows the target from where all others foretell it, metres. Raises CalibrationError."""
    refuse_other_size(solved.seen, solved.hand_eye, asked)
    errors_m = left_out_errors_m(solved.seen, solved.hand_eye, asked)
    refuse_moved(errors_m)
    return errors_m
