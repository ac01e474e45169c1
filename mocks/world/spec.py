"""The world that the three mocks share, as values: what is true, which the controller does not know.

Written as ``world.json`` into the run's folder before the mocks start; each mock reads it there. Beside it lies the
inlet's nominal shape as ``port_shape.json`` (``perception.port_shape_json``), since mocks read no YAML.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from perception.geometry import Pose
from perception.port_shape import PortShape
from perception.port_shape_json import shape_from_json, shape_to_json

Panel = Literal["port", "plain", "sphere", "corner"]
Vector6 = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class WorldSpec:
    """The truth of one mission. Poses are (x, y, z, rx, ry, rz): metres and rotation vector in radians."""

    seed: int
    port: str
    """Bundled port name of the vehicle's inlet."""
    T_base_port: Vector6
    T_flange_scanner: Vector6
    """Where the scanner truly is; the site's calibration may believe otherwise."""
    T_flange_tcp: Vector6
    """Where the plug truly is; what the controller is told as TCP may differ."""
    T_port_tcp: Vector6
    """Pose of the plug (TCP) in the port frame when it is fully mated."""
    panel: Panel = "port"
    """``plain``: a vehicle panel without any port. ``sphere``, ``corner``: a calibration target in its place."""
    sphere_radius_m: float = 0.0254
    """Of the sphere that is a calibration target."""
    glare_until_sweep: int = 0
    """The first N sweeps lose most returns near the port (sun glare): a scan that a locator must refuse."""
    blocked_depth_m: float | None = None
    """Something hard sits in the port at this depth below the rim plane."""
    capture_radius_m: float = 0.0025
    """Sideways offset of the plug that the lead-in still takes up; outside it, the plug lands on the face."""
    capture_tilt_rad: float = 0.0436
    capture_roll_rad: float = 0.0524
    profile_noise_m: float = 0.0001
    """1 sigma of each measured range."""
    time_scale: float = 1.0
    """Emulated seconds per wall second (--fast)."""
    arm_model: str = "ur10e"
    T_flange_coarse: Vector6 | None = None
    """Where a second, coarse scanner sits; None: there is none."""
    joint_offsets: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """True joint angles minus those that the arm reports: its flange is not quite where it says."""
    link_errors_m: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """True lengths d1, a2, a3, d4, d5, d6 of the arm minus those that it computes with."""
    joint_compliance_rad_per_nm: float = 0.0
    """How far each joint gives under the weight that it carries: its flange hangs lower than the arm says."""
    start_joints: Vector6 = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)

    @staticmethod
    def load(folder: Path) -> WorldSpec:
        """Read ``world.json`` from a run's folder."""
        values: Any = json.loads((folder / "world.json").read_text())
        fields: Any = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
        return WorldSpec(**fields)

    @staticmethod
    def load_shape(folder: Path) -> PortShape:
        """Read ``port_shape.json`` from a run's folder."""
        return shape_from_json((folder / "port_shape.json").read_text(encoding="utf-8"))

    def save_shape(self, folder: Path, shape: PortShape) -> None:
        """Write ``port_shape.json`` into a run's folder."""
        (folder / "port_shape.json").write_text(shape_to_json(shape), encoding="utf-8")

    def save(self, folder: Path) -> None:
        """Write ``world.json`` into a run's folder."""
        (folder / "world.json").write_text(json.dumps(dataclasses.asdict(self), indent=1))

    @property
    def port_pose(self) -> Pose:
        """``T_base_port`` of the first car, the truth."""
        return Pose.from_vector(self.T_base_port)
