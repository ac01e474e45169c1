"""The last centimetres: contact search, compliant insertion with our own force caps, bounded search, withdrawal.

``judge`` decides from the trace alone and is pure; ``insert`` and ``withdraw`` drive the arm and feed it. Forces are
what the environment does to the plug, in the port frame: positive axial force resists insertion.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from controller.cell import Cell
from controller.commands import Comply, MoveVelocity, StopMotion, ZeroForce
from controller.faults import FaultCode, MissionFault
from controller.insertion_config import InsertionConfig
from controller.planning import FACING, DockPlan
from drivers.base import ArmState, Compliance
from perception.geometry import Array, Pose

ENTERED_M = 0.003
"""Deeper than this without contact force: the plug is on its way in, the contact search has nothing to find."""
CLEAR_M = 0.004
"""The plug's face this far in front of the rim plane counts as out."""
SUSTAINED = 3
"""So many samples in a row above a cap make an overload: a single one is noise."""
PROGRESS_M = 0.0003
"""Less depth than this within ``stall_s`` is no progress."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One moment of an insertion, in the port frame."""

    time_s: float
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


class Verdict(enum.Enum):
    """What the trace says."""

    GOING = "going"
    SEATED = "seated"
    STALLED = "stalled"
    OVERLOAD = "overload"


@dataclass(frozen=True, slots=True)
class Insertion:
    """How an insertion ended."""

    verdict: Verdict
    contact: Contact
    trace: tuple[Sample, ...] = field(repr=False)
    detail: str = ""


def insert(cell: Cell, plan: DockPlan, settings: InsertionConfig, *, search: bool, timeout_s: float) -> Insertion:
    """From pre-contact to home. Leaves force mode on when seated, the arm stopped otherwise."""
    cell.settle(0.001, timeout_s)
    cell.do(ZeroForce())
    trace = Trace(cell, plan, settings)
    _search_contact(cell, plan, settings, trace, timeout_s)
    verdict = _push(cell, plan, settings, trace, search=search, timeout_s=timeout_s)
    if verdict is not Verdict.SEATED:
        cell.do(StopMotion())
    return Insertion(verdict, trace.contact(), tuple(trace.samples), _explain(verdict, trace, plan, settings))


def withdraw(cell: Cell, plan: DockPlan, settings: InsertionConfig, timeout_s: float) -> None:
    """Pull the plug out along the inserted axis with bounded force. Raises MissionFault when it does not come."""
    trace = Trace(cell, plan, settings)
    trace.update()
    if trace.samples[-1].depth_m < -CLEAR_M:
        return
    cell.do(Comply(_compliance(plan, settings, -settings.withdraw_force_n, settings.withdraw_speed_mm_s)))

    def out_or_stuck() -> bool:
        trace.update()
        return trace.samples[-1].depth_m < -CLEAR_M or trace.stalled(2.0 * settings.stall_s)

    ended = cell.supervisor.wait(out_or_stuck, timeout_s)
    cell.do(StopMotion())
    if not ended or trace.samples[-1].depth_m >= -CLEAR_M:
        depth_mm = trace.samples[-1].depth_m * 1000
        raise MissionFault(FaultCode.WITHDRAWAL_BLOCKED, f"the plug does not move at {depth_mm:.1f} mm depth")


# --- steps of an insertion ------------------------------------------------------------------------------------------


def _search_contact(cell: Cell, plan: DockPlan, settings: InsertionConfig, trace: Trace, timeout_s: float) -> None:
    """Slowly along the port's axis until something is felt, or the plug is on its way in."""
    inwards = plan.T_base_port.rotate(np.array([0.0, 0.0, -settings.contact_speed_mm_s / 1000.0]))
    cell.do(MoveVelocity(np.concatenate([inwards, np.zeros(3)]), 0.2))

    def felt() -> bool:
        trace.update()
        last = trace.samples[-1]
        force = max(abs(last.axial_n), last.lateral_n)
        return force > settings.contact_force_n or last.depth_m > ENTERED_M

    if not cell.supervisor.wait(felt, timeout_s):
        raise MissionFault(FaultCode.MOTION_FAILED, "no contact and no progress in the contact search")
    cell.do(StopMotion())


def _push(
    cell: Cell, plan: DockPlan, settings: InsertionConfig, trace: Trace, *, search: bool, timeout_s: float
) -> Verdict:
    """Compliant push; when it stalls and ``search`` is set, with a lateral force that turns round the axis."""
    push = _compliance(plan, settings, settings.push_force_n, settings.speed_limit_mm_s)
    cell.do(Comply(push))
    trace.restart_stall_clock()
    verdict = _watch(cell, settings, plan, trace, timeout_s)
    if verdict is not Verdict.STALLED or not search:
        return verdict
    end_s = cell.clock.now_s() + settings.search_s
    for lateral in _search_forces(settings):
        if cell.clock.now_s() > end_s:
            break
        force = lateral if trace.samples[-1].offset_m < settings.search_radius_mm / 1000.0 else np.zeros(2)
        cell.do(Comply(_compliance(plan, settings, settings.push_force_n, settings.speed_limit_mm_s, force)))
        trace.restart_stall_clock()
        verdict = _watch(cell, settings, plan, trace, 0.4)
        if verdict in (Verdict.SEATED, Verdict.OVERLOAD):
            return verdict
    return Verdict.STALLED


def _watch(cell: Cell, settings: InsertionConfig, plan: DockPlan, trace: Trace, timeout_s: float) -> Verdict:
    """Wait for the trace to say something; GOING if it did not within ``timeout_s``."""

    def decided() -> bool:
        trace.update()
        return judge(trace, plan, settings) is not Verdict.GOING

    cell.supervisor.wait(decided, timeout_s)
    return judge(trace, plan, settings)


def _search_forces(settings: InsertionConfig) -> Iterator[Array]:
    """Lateral forces (2,) N that turn and grow up to ``search_force_n``: a spiral in force."""
    for turn in range(10_000):
        angle = 0.7 * turn
        size = settings.search_force_n * min(1.0, (turn + 4) / 24.0)
        yield size * np.array([np.cos(angle), np.sin(angle)])


def _compliance(
    plan: DockPlan, settings: InsertionConfig, push_n: float, speed_mm_s: float, lateral_n: Array | None = None
) -> Compliance:
    """Force mode in the port's frame turned into the vehicle: z is the insertion axis, all axes yield."""
    x, y = (0.0, 0.0) if lateral_n is None else (float(lateral_n[0]), float(lateral_n[1]))
    across = settings.lateral_speed_limit_mm_s / 1000.0
    turn = float(np.deg2rad(settings.tilt_speed_limit_deg_s))
    return Compliance(
        T_base_task=Pose(plan.T_base_port.rotation @ FACING, plan.T_base_port.translation),
        selection=(True, True, True, True, True, True),
        wrench=(x, y, push_n, 0.0, 0.0, 0.0),
        limits=(across, across, speed_mm_s / 1000.0, turn, turn, turn),
    )


# --- the trace and what it says -------------------------------------------------------------------------------------


class Trace:
    """All samples of one insertion at the rate of the arm's state, and when progress was last made."""

    def __init__(self, cell: Cell, plan: DockPlan, settings: InsertionConfig) -> None:
        self._cell = cell
        self._plan = plan
        self.samples: list[Sample] = []
        self._last_state: ArmState | None = None
        self._newest_s = cell.wall.now_s() - 0.05
        self._progress_depth_m = -np.inf
        self._progress_s = -np.inf

    def update(self) -> None:
        """Take in all arm states since the last call."""
        states = self._cell.arm.history(self._newest_s)
        if not states and not self.samples:
            states = [self._cell.arm.state()]
        for state in states:
            self._newest_s, self._last_state = state.time_s, state
            self.samples.append(sample(state, self._plan))
        last = self.samples[-1]
        if abs(last.depth_m - self._progress_depth_m) > PROGRESS_M:
            self._progress_depth_m, self._progress_s = last.depth_m, last.time_s

    def restart_stall_clock(self) -> None:
        """Give a new push its own time to make progress."""
        self._progress_s = self.samples[-1].time_s

    def stalled(self, after_s: float) -> bool:
        """No progress for ``after_s``."""
        return self.still_for_s() > after_s

    def still_for_s(self) -> float:
        """How long the depth has not changed, by the arm's own clock: samples that are late are no stall."""
        return self.samples[-1].time_s - self._progress_s

    def contact(self) -> Contact:
        """Expected against actual for the newest sample."""
        state = self._last_state or self._cell.arm.state()
        peak_n = max((max(abs(s.axial_n), s.lateral_n) for s in self.samples), default=0.0)
        return contact(state.T_base_tcp, self._plan, peak_n)


def judge(trace: Trace, plan: DockPlan, settings: InsertionConfig) -> Verdict:
    """Seated, stalled, overloaded, or still going."""
    recent = trace.samples[-SUSTAINED:]
    if len(recent) == SUSTAINED and all(_over_caps(s, settings) for s in recent):
        return Verdict.OVERLOAD
    last = trace.samples[-1]
    home = last.depth_m > plan.mated_depth_m - settings.seated_within_mm / 1000.0
    if home and trace.still_for_s() > settings.plateau_s and last.axial_n > 0.5 * settings.push_force_n:
        return Verdict.SEATED
    if not home and trace.still_for_s() > settings.stall_s:
        return Verdict.STALLED
    return Verdict.GOING


def _over_caps(s: Sample, settings: InsertionConfig) -> bool:
    return (
        abs(s.axial_n) > settings.max_axial_force_n
        or s.lateral_n > settings.max_lateral_force_n
        or s.moment_nm > settings.max_moment_nm
    )


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


def _explain(verdict: Verdict, trace: Trace, plan: DockPlan, settings: InsertionConfig) -> str:
    last = trace.samples[-1]
    where = f"at {last.depth_m * 1000:.1f} of {plan.mated_depth_m * 1000:.1f} mm"
    match verdict:
        case Verdict.SEATED:
            return f"home {where}, {last.axial_n:.0f} N"
        case Verdict.OVERLOAD:
            return f"{last.axial_n:.0f} N axial, {last.lateral_n:.0f} N lateral, {last.moment_nm:.1f} Nm {where}"
        case Verdict.STALLED:
            return f"no progress {where} with {last.axial_n:.0f} N"
        case Verdict.GOING:
            return f"time ran out {where} (push {settings.push_force_n:.0f} N)"
