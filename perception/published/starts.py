"""Start poses (an extension): the given start, and 27 rotations around it with the clouds' medians laid on each other.

The published method starts once and is caught by the nearest minimum from about 20 degrees on. Millimetres.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from perception.geometry import Array, Pose

_STEP_DEG = 25.0


def start_poses(test: Array, target: Array, start: Pose) -> list[Pose]:
    """``start`` and 27 poses whose rotation differs from it by -25, 0 or 25 degrees about each axis."""
    centre_test, centre_target = np.median(test, axis=0), np.median(target, axis=0)
    poses = [start]
    for steps in product((0.0, -1.0, 1.0), repeat=3):
        turn = Rotation.from_rotvec(np.deg2rad(_STEP_DEG) * np.array(steps)).as_matrix()
        rotation = turn @ start.rotation
        poses.append(Pose(rotation, centre_target - rotation @ centre_test))
    return poses
