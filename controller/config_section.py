"""What every section of the configuration is made of."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict

from perception.errors import PortdockError
from perception.geometry import Pose

Vector3 = tuple[float, float, float]


class ConfigError(PortdockError):
    """The configuration cannot be used as it is (exit code 2)."""

    code: ClassVar[str] = "config"
    default_remedy: ClassVar[str] = "Correct the key named above; `portdock config check FILE` checks a file alone."


class Section(BaseModel):
    """Base of all sections: immutable, no unknown keys, a doc string below each key that needs one."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


class PoseConfig(Section):
    """A rigid transform as millimetres and a rotation vector in degrees."""

    xyz_mm: Vector3 = (0.0, 0.0, 0.0)
    """Translation."""
    rotvec_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector: its direction is the axis, its length the angle."""

    @staticmethod
    def of(pose: Pose) -> PoseConfig:
        """A pose in SI as it stands in a site file."""
        x, y, z = (1e3 * float(v) for v in pose.translation)
        rx, ry, rz = (float(v) for v in np.rad2deg(pose.rotvec))
        return PoseConfig(xyz_mm=(x, y, z), rotvec_deg=(rx, ry, rz))

    @property
    def pose(self) -> Pose:
        """The same in SI."""
        return Pose.from_rotvec(np.deg2rad(self.rotvec_deg), np.asarray(self.xyz_mm) / 1000.0)
