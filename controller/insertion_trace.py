"""What an arm feels and where its plug is while it inserts or withdraws, in the port's frame, at the state's own rate.

Forces are what the environment does to the plug: positive axial force resists insertion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from controller.cell import Cell
from controller.planning import DockPlan
from drivers.base import ArmState
from perception.geometry import Array, Pose

CLEAR_M = 0.004
"""The plug's face this far in front of the rim plane counts as out."""
LOOK_BACK_S = 0.05
"""A trace begins with what was received this long before it."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One moment of an insertion, in the port frame."""

    time_s: float
    """By the arm's own clock."""
    depth_m: float
    axial_n: float
    lateral_n: float
    moment_nm: float
    offset_m: float
    """Distance of the plug's axis from the planned axis."""


@dataclass(frozen=True, slots=True)
class Contact:
    """Expected against actual: what every contact leaves behind, also a failed one."""

    along_m: float
    """Positive when the plug stopped short of home."""
    lateral_m: float
    roll_rad: float
    tilt_rad: float
    peak_force_n: float


class Trace:
    """All samples of one insertion at the rate of the arm's state, and when progress was last made."""

    def __init__(self, cell: Cell, plan: DockPlan, progress_m: float) -> None:
        """``progress_m``: less depth than this is no progress."""
        self._cell = cell
        self._plan = plan
        self._progress_m = progress_m
        self.samples: list[Sample] = []
        self._last_state: ArmState | None = None
        self._newest_s = cell.wall.now_s() - LOOK_BACK_S
        self._progress_depth_m = -np.inf
        self._progress_s = -np.inf

    def update(self) -> Sample:
        """Take in all arm states since the last call; the newest sample."""
        states = self._cell.arm.history(self._newest_s)
        if not states and not self.samples:
            states = [self._cell.arm.state()]
        for state in states:
            self._newest_s, self._last_state = state.time_s, state
            self._add(sample(state, self._plan))
        return self.last

    def _add(self, new: Sample) -> None:
        """Progress is judged sample by sample: it must not depend on when somebody looks, or a replay would differ."""
        self.samples.append(new)
        if abs(new.depth_m - self._progress_depth_m) > self._progress_m:
            self._progress_depth_m, self._progress_s = new.depth_m, new.time_s

    @property
    def last(self) -> Sample:
        """The newest sample."""
        return self.samples[-1]

    def restart_stall_clock(self) -> None:
        """Give a new push its own time to make progress."""
        self._progress_s = self.last.time_s

    def stalled(self, after_s: float) -> bool:
        """No progress for ``after_s``."""
        return self.still_for_s() > after_s

    def still_for_s(self) -> float:
        """How long the depth has not changed, by the arm's own clock: samples that are late are no stall."""
        return self.last.time_s - self._progress_s

    def off_axis(self) -> tuple[Array, float]:
        """Where the plug is beside the planned axis, (2,) m in the port's x and y, and how far turned about it, rad."""
        state = self._last_state or self._cell.arm.state()
        T_port_tcp = self._plan.T_base_port.inverse() @ state.T_base_tcp
        mated = self._plan.T_port_tcp_mated
        turn = Rotation.from_matrix(T_port_tcp.rotation @ mated.rotation.T).as_rotvec()
        return (T_port_tcp.translation - mated.translation)[:2], float(turn[2])

    def contact(self) -> Contact:
        """Expected against actual for the newest sample."""
        state = self._last_state or self._cell.arm.state()
        peak_n = max((max(abs(s.axial_n), s.lateral_n) for s in self.samples), default=0.0)
        return contact(state.T_base_tcp, self._plan, peak_n)


def sample(state: ArmState, plan: DockPlan) -> Sample:
    """An arm state as seen from the port."""
    T_port_base = plan.T_base_port.inverse()
    T_port_tcp = T_port_base @ state.T_base_tcp
    force = T_port_base.rotate(state.wrench[:3])
    offset = T_port_tcp.translation[:2] - plan.T_port_tcp_mated.translation[:2]
    return Sample(
        time_s=state.device_time_s,
        depth_m=-float(T_port_tcp.translation[2]),
        axial_n=float(force[2]),
        lateral_n=float(np.hypot(force[0], force[1])),
        moment_nm=float(np.linalg.norm(state.wrench[3:])),
        offset_m=float(np.hypot(offset[0], offset[1])),
    )


def contact(T_base_tcp: Pose, plan: DockPlan, peak_force_n: float) -> Contact:
    """Where the plug is against where it should be when home."""
    T_mated_tcp = plan.mated.inverse() @ T_base_tcp
    axis = T_mated_tcp.rotation[:, 2]
    tilt = float(np.arctan2(np.hypot(axis[0], axis[1]), axis[2]))
    roll = float(Rotation.from_matrix(T_mated_tcp.rotation).as_euler("ZYX")[0])
    x, y, z = T_mated_tcp.translation
    return Contact(-float(z), float(np.hypot(x, y)), roll, tilt, peak_force_n)
