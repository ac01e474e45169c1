"""The arm as configuration: which robot, its tool, its limits, and what stands around it."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from controller.config_section import PoseConfig, Section, Vector3
from perception.geometry import Array

Size = Annotated[float, Field(gt=0, le=10_000)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Joints = tuple[Angle, Angle, Angle, Angle, Angle, Angle]


class BoxConfig(Section):
    """Something solid that stands still in the base frame."""

    name: Annotated[str, Field(min_length=1)]
    """What it is, as errors name it."""
    T_base_box: PoseConfig = PoseConfig()
    """Pose of the box's centre."""
    size_mm: tuple[Size, Size, Size]
    """Lengths of its edges."""
    tool_may_touch: bool = False
    """True for what the plug is meant to meet."""


LengthError = Annotated[float, Field(ge=-2, le=2)]
ZeroError = Annotated[float, Field(ge=-0.2, le=0.2)]
Six = tuple[float, float, float, float, float, float]


class ArmErrorsConfig(Section):
    """What the arm does not know of itself. A hand-eye calibration estimates it, as far as its sweeps tell.

    True less believed, in the order of the joints; Denavit-Hartenberg lengths as the maker publishes them.
    """

    a_mm: tuple[LengthError, LengthError, LengthError, LengthError, LengthError, LengthError] = (0.0,) * 6
    """Lengths along the links."""
    d_mm: tuple[LengthError, LengthError, LengthError, LengthError, LengthError, LengthError] = (0.0,) * 6
    """Lengths along the joints' axes."""
    zeros_deg: tuple[ZeroError, ZeroError, ZeroError, ZeroError, ZeroError, ZeroError] = (0.0,) * 6
    """True joint angles less those that the arm reports."""
    compliance_urad_per_nm: Annotated[float, Field(ge=-50, le=50)] = 0.0
    """How far each joint gives under the weight that it carries."""

    @staticmethod
    def of(errors: Array) -> ArmErrorsConfig:
        """From (19,) in SI, in the order of ``perception.calibration.arm_errors``."""
        a_mm, d_mm, zeros_deg = (_six(v) for v in (1e3 * errors[:6], 1e3 * errors[6:12], np.rad2deg(errors[12:18])))
        return ArmErrorsConfig(
            a_mm=a_mm, d_mm=d_mm, zeros_deg=zeros_deg, compliance_urad_per_nm=1e6 * float(errors[18])
        )

    @property
    def errors(self) -> Array | None:
        """(19,) in SI; None where all are zero."""
        lengths_m, zeros_rad = 1e-3 * np.array([*self.a_mm, *self.d_mm]), np.deg2rad(self.zeros_deg)
        errors = np.concatenate([lengths_m, zeros_rad, [1e-6 * self.compliance_urad_per_nm]])
        return errors if errors.any() else None


def _six(values: Array) -> Six:
    a, b, c, d, e, f = (float(value) for value in values)
    return a, b, c, d, e, f


class ArmConfig(Section):
    """The Universal Robots arm."""

    model: str = "ur10e"
    """ur3e, ur5e, ur10e, ur16e, ur20 or ur30; the robot found must be this one."""
    host: str = "192.168.0.10"
    """Address of the robot controller."""
    serial: str | None = None
    """Serial number that the robot must have. None: any."""
    errors: ArmErrorsConfig = ArmErrorsConfig()
    """Zero: the arm is taken at its word. A hand-eye calibration's errors take the place of these."""
    T_flange_tcp: PoseConfig = PoseConfig()
    """The plug's frame at the flange: origin on the plug's foremost face, z into the port, x along the port's x."""
    payload_kg: Annotated[float, Field(ge=0, le=30)] = 3.0
    """Mass of plug, tool and the part of the cable that the arm carries."""
    centre_of_gravity_mm: Vector3 = (0.0, 0.0, 80.0)
    """The payload's centre of gravity in the flange frame."""
    frequency_hz: Literal[125, 500] = 500
    """Rate of the state link."""
    watchdog_hz: Annotated[float, Field(ge=0.2, le=50)] = 10.0
    """The robot stops when kicks come more slowly than this."""
    freshness_ms: Annotated[float, Field(ge=20, le=5000)] = 200.0
    """A state older than this is stale: no command is given."""
    upper_registers: bool = False
    """Use RTDE registers 24 and up, where a fieldbus owns the lower ones (PolyScope below 5.23)."""
    stop_running_program: bool = False
    """Whether another program that is found running may be stopped."""
    workspace_min_mm: Vector3 = (-1300.0, -1300.0, -300.0)
    """Least x, y, z of the tool in the base frame."""
    workspace_max_mm: Vector3 = (1300.0, 1300.0, 1300.0)
    """Greatest x, y, z of the tool in the base frame."""
    joint_min_deg: Joints = (-360.0,) * 6
    """Least angle of each joint."""
    joint_max_deg: Joints = (360.0,) * 6
    """Greatest angle of each joint."""
    least_singular_value: Annotated[float, Field(ge=0, le=0.5)] = 0.02
    """Straight lines that come nearer to a singularity (smallest singular value of the Jacobian) are refused."""
    tool_radius_mm: Annotated[float, Field(gt=0, le=500)] = 50.0
    """Of a capsule around what carries the plug, from the flange to where the plug begins."""
    plug_radius_mm: Annotated[float, Field(gt=0, le=200)] = 35.0
    """Of a capsule around the plug: half of its width at the grip."""
    plug_length_mm: Annotated[float, Field(ge=0, le=500)] = 60.0
    """How much of the tool, back from the TCP, is no wider than the plug; 0: nothing."""
    least_clearance_mm: Annotated[float, Field(ge=0, le=500)] = 0.0
    """Between the arm's capsules, which are generous already, and themselves and every box."""
    boxes: tuple[BoxConfig, ...] = ()
    """What the arm must keep clear of: pedestal, wall, charger."""
