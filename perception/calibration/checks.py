"""Whether a solved calibration may be believed: the target's size, one target in all sweeps, each sweep foretold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from perception.calibration.errors import CalibrationError
from perception.calibration.hand_eye import Asked, HandEye, solve
from perception.calibration.sightings import Sightings
from perception.calibration.targets import PlanesTarget, SphereTarget, Target
from perception.calibration.uncertainty import sweep_shifts
from perception.geometry import Array

SIZE_TOLERANCE_M = 0.0003
"""Beyond this, and beyond four standard deviations, the sphere is another one."""
MOVED_M = 0.0015
"""A sweep that shows the target further than this from where all others foretell it."""
MIN_SWEEPS = 4


def refuse_other_size(seen: Sightings, solved: HandEye, asked: Asked) -> None:
    """Raises CalibrationError if the sphere's own points say that its radius is another."""
    target = solved.target
    if not isinstance(target, SphereTarget):
        return
    measured = solve(seen, replace(target, radius_free=True), solved.mounting, asked).target
    assert isinstance(measured, SphereTarget)
    if abs(measured.radius_m - target.radius_m) > SIZE_TOLERANCE_M:
        raise CalibrationError(
            f"the sphere's diameter is {2e3 * measured.radius_m:.2f} mm, not {2e3 * target.radius_m:.2f} mm",
            remedy="Measure the sphere and give its diameter with --diameter-mm.",
        )


def left_out_errors_m(seen: Sightings, solved: HandEye, asked: Asked) -> Array:
    """(S,) for each sweep: how far from where all other sweeps foretell it, it shows the target.

    :raises CalibrationError: fewer than ``MIN_SWEEPS`` sweeps
    """
    owner = seen.sweep_of_point
    sweeps = np.unique(owner)
    if len(sweeps) < MIN_SWEEPS:
        raise CalibrationError(
            f"{len(sweeps)} sweeps are too few: at least {MIN_SWEEPS}",
            remedy="Sweep from more poses; --plan names them.",
        )
    errors = []
    for sweep in sweeps:
        others, alone = owner != sweep, owner == sweep
        foretold = solve(seen.of(others), solved.target.of(others), solved.mounting, asked)
        left = seen.of(alone)
        distances = _seen_by(foretold.target, solved.target, alone).distances(left.in_base(foretold.mounting))
        errors.append(float(np.linalg.norm(sweep_shifts(distances, left)[0])))
    return np.array(errors)


def _seen_by(foretold: Target, whole: Target, points: NDArray[np.bool_]) -> Target:
    """The target as some sweeps foretell it, for the points of another."""
    if isinstance(foretold, PlanesTarget) and isinstance(whole, PlanesTarget):
        return replace(foretold, plane=whole.plane[points])
    return foretold


def refuse_moved(errors_m: Array) -> None:
    """Raises CalibrationError if one sweep shows the target elsewhere than the others do."""
    worst = int(np.argmax(errors_m))
    typical = float(np.median(errors_m))
    if errors_m[worst] > max(MOVED_M, 5.0 * typical):
        raise CalibrationError(
            f"sweep {worst + 1} shows the target {1e3 * errors_m[worst]:.1f} mm from where the others foretell it",
            remedy="Target or robot base moved, or the arm is off in that pose: fix the target and sweep again.",
        )
