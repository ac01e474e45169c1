"""What the thinking process does for a hand-eye calibration, with the port model that it keeps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from controller.port_models import port_model
from perception.calibration.from_sweeps import Solved, TargetKind, port_place, solve_port_sweeps, solve_sweeps
from perception.calibration.hand_eye import Asked
from perception.calibration.sightings import Mounting
from perception.calibration.skins import Skin, corner_skin, expected_corner, port_skin, sphere_skin
from perception.calibration.targets import PlanesTarget, SphereTarget, Target
from perception.geometry import Pose
from perception.port_model import PortModel
from perception.scan import Scan


def solved(scans: Sequence[Scan], kind: TargetKind, T_base_target: Pose, guess: Mounting, asked: Asked) -> Solved:
    """The mounting from sweeps of any target. Raises CalibrationError.

    :param T_base_target: where a port is expected; the other targets are sought without it
    """
    if kind.name != "port":
        return solve_sweeps(scans, kind, guess, asked)
    return solve_port_sweeps(scans, _model(kind.port), T_base_target, guess, asked)


def placed(scan: Scan, port: str, T_base_port: Pose, guess: Mounting) -> Pose:
    """T_base_port as one sweep shows it. Raises CalibrationError."""
    return port_place(scan, _model(port), T_base_port, guess)


def expected_skin(kind: TargetKind, T_base_target: Pose, found: Target | None) -> Skin:
    """What the next sweeps may meet: of the target as the last solution has it, else where it is expected."""
    if kind.name == "sphere":
        return sphere_skin(SphereTarget(T_base_target.translation, kind.radius_m))
    if kind.name == "port":
        return port_skin(T_base_target, _model(kind.port).surface)
    corner = found if isinstance(found, PlanesTarget) else expected_corner(T_base_target)
    return corner_skin(corner, BASE)


BASE = np.zeros(3)
"""The robot stands here: a corner points at it."""


@lru_cache(maxsize=1)
def _model(name: str) -> PortModel:
    return port_model(name)
