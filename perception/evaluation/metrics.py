"""How good a registration is, equations (17) and (19) to (22) and what they leave open. Millimetres.

``E`` below is the error of an estimate: ``T_estimated @ inverse(T_true)``, a motion within the target's frame that
is the identity for a perfect answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array, Pose
from perception.published.registration import keypoint_loss

Cells = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class EntryErrors:
    """Equations (19) to (21) over all trials and entries: 9 of each rotation matrix, 3 of each translation (mm)."""

    rotation_mse: float
    rotation_rmse: float
    rotation_mae: float
    translation_mse: float
    translation_rmse: float
    translation_mae: float


def entry_errors(estimated: list[Pose], true: list[Pose]) -> EntryErrors:
    """MSE (19), RMSE (20) and MAE (21). RMSE is the root of MSE and tells nothing new; it is in the paper's figure."""
    r = np.stack([a.rotation - b.rotation for a, b in zip(estimated, true, strict=True)])
    t = np.stack([a.translation - b.translation for a, b in zip(estimated, true, strict=True)])
    r_mse, t_mse = float((r**2).mean()), float((t**2).mean())
    return EntryErrors(
        r_mse, float(np.sqrt(r_mse)), float(np.abs(r).mean()), t_mse, float(np.sqrt(t_mse)), float(np.abs(t).mean())
    )


def common_loss(error: Pose, reference: Array) -> float:
    """Equation (17) with fixed reference points (A, 3) on the port and their true counterparts, mm^2.

    The only loss that compares algorithms: each algorithm's own keypoint loss depends on its own keypoints. Never
    shown to an algorithm.
    """
    return keypoint_loss(error.apply(reference), reference)


def angle_deg(error: Pose) -> float:
    """Geodesic angle of the rotation error."""
    return float(np.rad2deg(error.angle_to(Pose.identity())))


def centre_error_mm(error: Pose, centre: Array) -> float:
    """Displacement of the port's centre (3,): the translation entries alone depend on where the frame's origin is."""
    return float(np.linalg.norm(error.apply(centre) - centre))


def recognised(angle: float, centre: float, within: float = 2.0) -> bool:
    """Recognition success: within 2 deg and 2 mm at the port's centre (or another number of both)."""
    return angle < within and centre < within


@dataclass(frozen=True)
class Occupancy:
    """Equation (22) read as occupied voxels: the target's cells on a grid fixed at its bounding box's corner."""

    target: Array
    edge_mm: float

    @cached_property
    def origin(self) -> Array:
        """(3,) corner of the grid."""
        return np.asarray(self.target.min(axis=0))

    @cached_property
    def cells(self) -> Cells:
        """Sorted cell numbers of the target."""
        return self._occupied(self.target)

    def iou(self, points: Array) -> float:
        """|A and B| / |A or B| for points (N, 3) in the target's frame."""
        other = self._occupied(points)
        common = np.intersect1d(self.cells, other, assume_unique=True).size
        union = self.cells.size + other.size - common
        return float(common / union) if union else 0.0

    def _occupied(self, points: Array) -> Cells:
        cell = np.floor((points - self.origin) / self.edge_mm).astype(np.int64) + 2**19
        cell = np.clip(cell, 0, 2**20 - 1)
        return np.unique((cell[:, 0] << 40) | (cell[:, 1] << 20) | cell[:, 2])
