"""What the gate judges by: every limit, what is known of the cell at the moment, and the form of a refusal."""

from __future__ import annotations

from dataclasses import dataclass

from controller.states import State
from drivers.base import ArmState, ChargerStatus
from perception.geometry import Pose

CONTACT_DEPTH_M = 0.0
"""Plug depth from which it counts as inserted: its front face has passed the rim plane."""
STILL_M_S = 0.002
"""A TCP slower than this is at rest."""
LIVE_CURRENT_A = 1.0
"""Below this current a contactor may be opened and a plug pulled."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Every bound the gate enforces, SI."""

    workspace_min_m: tuple[float, float, float]
    workspace_max_m: tuple[float, float, float]
    joint_speed_rad_s: float
    linear_speed_m_s: float
    insertion_speed_m_s: float
    withdraw_speed_m_s: float
    insertion_turn_rad_s: float
    axial_force_n: float
    lateral_force_n: float
    moment_nm: float
    capture_radius_m: float
    """No lateral motion beyond this while the plug is inserted."""
    touch_force_n: float = 10.0
    """A larger force on the plug is contact."""


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What the gate judges by. None means: not known freshly."""

    state: State
    arm: ArmState | None
    charger: ChargerStatus | None
    T_base_port: Pose | None = None
    """The port pose of the current plan, or the stored insertion axis."""
    mated: bool = False


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why the gate said no."""

    rule: str
    detail: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.detail}"
