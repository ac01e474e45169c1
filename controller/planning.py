"""From poses to plans: viewpoints for the sweep; pre-contact, insertion axis, depth and retreat for the dock. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from controller.config import MotionConfig, ScanConfig, ViewpointConfig
from perception.errors import PortdockError
from perception.estimate import PortEstimate
from perception.geometry import Pose

FACING = np.diag([1.0, -1.0, -1.0])
"""Scanner and plug look into the port: their z is the port's -z, their x the port's x."""

ReachCheck = Callable[[Sequence[Pose]], str | None]
"""TCP poses in the order of travel -> why they cannot be followed, or None."""


class PlanRefusedError(PortdockError):
    """No safe plan exists for this estimate."""

    code = "plan-refused"
    default_remedy = "Park the car within the arm's reach, or change scan.viewpoints."


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """A straight sweep of the TCP; the scanner looks at the expected port all the way."""

    T_base_tcp_start: Pose
    T_base_tcp_end: Pose


@dataclass(frozen=True, slots=True, eq=False)
class DockPlan:
    """One docking: all poses are T_base_tcp."""

    T_base_port: Pose
    T_port_tcp_mated: Pose
    pre_contact: Pose
    """On the port's axis, in front of the rim plane."""
    mated: Pose
    retreat: Pose
    """On the port's axis, clear of the vehicle."""

    def depth_m(self, T_base_tcp: Pose) -> float:
        """How far the plug's front face is behind the rim plane."""
        return -float((self.T_base_port.inverse() @ T_base_tcp).translation[2])

    def lateral_m(self, T_base_tcp: Pose) -> float:
        """How far beside the insertion axis the TCP is."""
        offset = (self.T_base_port.inverse() @ T_base_tcp).translation - self.T_port_tcp_mated.translation
        return float(np.hypot(offset[0], offset[1]))

    @property
    def mated_depth_m(self) -> float:
        """Depth at which the plug is home."""
        return -float(self.T_port_tcp_mated.translation[2])


def plan_viewpoint(
    T_base_port: Pose, view: ViewpointConfig, scan: ScanConfig, T_flange_scanner: Pose, T_flange_tcp: Pose
) -> Viewpoint:
    """The sweep that looks at the port from one viewpoint, downwards in the port's frame."""
    tilt = Pose.from_rotvec(np.deg2rad([view.pitch_deg, view.yaw_deg, 0.0]))
    centre = np.array([*scan.centre_mm, 0.0]) / 1000.0
    facing = Pose(np.eye(3), centre) @ tilt @ Pose(FACING, np.array([0.0, 0.0, scan.standoff_mm / 1000.0]))
    T_scanner_tcp = T_flange_scanner.inverse() @ T_flange_tcp
    half = scan.length_mm / 2000.0
    start, end = (T_base_port @ facing.moved([0.0, y, 0.0]) @ T_scanner_tcp for y in (-half, half))
    return Viewpoint(start, end)


def plan_dock(estimate: PortEstimate, T_port_tcp_mated: Pose, motion: MotionConfig, reach: ReachCheck) -> DockPlan:
    """The docking for an accepted estimate in the base frame. Raises PlanRefusedError."""
    if not estimate.accepted:
        raise PlanRefusedError("the port's pose was not accepted", remedy="Scan again from another viewpoint.")
    if estimate.ref != "base":
        raise PlanRefusedError("the port's pose is not in the base frame", remedy="Join the scan with the arm's poses.")
    T_base_port = estimate.T_ref_port
    plan = plan_on_axis(T_base_port, T_port_tcp_mated, motion)
    if why := reach([plan.retreat, plan.pre_contact, plan.mated]):
        raise PlanRefusedError(f"the arm cannot follow the approach: {why}")
    return plan


def plan_on_axis(T_base_port: Pose, T_port_tcp_mated: Pose, motion: MotionConfig) -> DockPlan:
    """The poses of a docking on a port whose pose is known, or was when its axis was stored."""
    return DockPlan(
        T_base_port=T_base_port,
        T_port_tcp_mated=T_port_tcp_mated,
        pre_contact=T_base_port @ _on_axis(T_port_tcp_mated, motion.pre_contact_mm / 1000.0),
        mated=T_base_port @ T_port_tcp_mated,
        retreat=T_base_port @ _on_axis(T_port_tcp_mated, motion.retreat_mm / 1000.0),
    )


def _on_axis(T_port_tcp: Pose, height_m: float) -> Pose:
    """The same orientation on the insertion axis, ``height_m`` in front of the rim plane."""
    x, y, _ = T_port_tcp.translation
    return Pose(T_port_tcp.rotation, np.array([x, y, height_m]))
