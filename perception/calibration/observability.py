"""Whether the sweeps determine every parameter, and if not, which motion is missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perception.calibration.errors import CalibrationError
from perception.geometry import Array

UNITS = np.array([1e-3, 1e-3, 1e-3, 2e-3, 2e-3, 2e-3, 1e-2, 1e-2])
"""What counts as equally much of x, y, z, rx, ry, rz, time offset and speed scale: each moves points by millimetres."""
NOISE_M = 1e-4
"""Of one point, for the prediction."""
LIMIT = 1.0
"""A direction that 0.1 mm of noise leaves uncertain by more than this many units is not determined."""
REMEDIES = (
    "All sweeps have nearly one orientation: turn the scanner by 20 deg and more about two axes between sweeps.",
    "All sweeps see the target at one place of the laser line: vary stand-off and sideways place between sweeps.",
    "Time offset and mounting look alike when all sweeps run one way: sweep to and fro.",
    "The speed scale needs sweeps in several directions across the target.",
)
_REMEDY_OF = (0, 0, 0, 1, 1, 1, 2, 3)


def refuse_undetermined(jacobian: Array, weights: Array, chosen: NDArray[np.bool_]) -> None:
    """Raises CalibrationError that names the missing motion.

    :param jacobian: (N, parameters chosen + target's own)
    :param chosen: (8,) which parameters of the mounting are estimated
    """
    uncertain, axis = worst_direction(jacobian, weights, chosen)
    if uncertain > LIMIT:
        worst = int(np.flatnonzero(chosen)[np.argmax(np.abs(axis))])
        name = ("position", "rotation", "time offset", "speed scale")[_REMEDY_OF[worst]]
        raise CalibrationError(f"the sweeps do not determine the scanner's {name}", remedy=REMEDIES[_REMEDY_OF[worst]])


def worst_direction(jacobian: Array, weights: Array, chosen: NDArray[np.bool_]) -> tuple[float, Array]:
    """The least determined direction among the mounting's parameters: its standard deviation in ``UNITS``, and itself.

    The target's own parameters are eliminated first (Schur complement).
    """
    k = int(chosen.sum())
    j = jacobian.copy()
    j[:, :k] *= UNITS[chosen]
    normal = (j * weights[:, None]).T @ j
    own = normal[k:, k:] + 1e-12 * np.trace(normal[k:, k:]) * np.eye(len(normal) - k)
    left = normal[:k, :k] - normal[:k, k:] @ np.linalg.solve(own, normal[k:, :k])
    values, vectors = np.linalg.eigh(0.5 * (left + left.T))
    return NOISE_M / float(np.sqrt(max(values[0], 1e-30))), np.asarray(vectors[:, 0])
