"""The last centimetres: contact search, compliant insertion with our own force caps, easing of a jam, bounded search.

``judge`` (insertion_verdict.py) decides from the trace alone and is pure; the functions here drive the arm and feed it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from controller.cell import Cell
from controller.commands import Comply, MoveVelocity, StopMotion, ZeroForce
from controller.faults import FaultCode, MissionFault
from controller.insertion_config import InsertionConfig
from controller.insertion_search import Spiral, next_step
from controller.insertion_trace import CLEAR_M as CLEAR_M
from controller.insertion_trace import Contact as Contact
from controller.insertion_trace import Sample as Sample
from controller.insertion_trace import Trace
from controller.insertion_verdict import ENDS, explain, judge
from controller.insertion_verdict import Verdict as Verdict
from controller.planning import FACING, DockPlan
from drivers.base import Compliance
from perception.geometry import Array, Pose

SEARCH_STEP_S = 0.05
"""So often is the plug's way corrected while it searches; seconds of the arm's own clock."""
SLOWING_M_S2 = 0.2
ALL_AXES = (True,) * 6
ALONG_AND_TILT = (False, False, True, True, True, False)
"""What yields while the plug is led across the face and turned."""
DEVIATION_M, DEVIATION_RAD = 0.01, 0.1
"""How far axes that do not yield may be pressed off their way before the controller stops by itself."""


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
    inserting = _Inserting(cell, plan, settings, timeout_s)
    inserting.search_contact()
    verdict = inserting.push_eased()
    if verdict in (Verdict.STALLED, Verdict.JAMMED) and search:
        verdict = inserting.search(verdict)
    if verdict is not Verdict.SEATED:
        cell.do(StopMotion())
    trace = inserting.trace
    return Insertion(verdict, trace.contact(), tuple(trace.samples), explain(verdict, trace, plan, settings))


@dataclass(slots=True)
class _Inserting:
    """One insertion under way."""

    cell: Cell
    plan: DockPlan
    settings: InsertionConfig
    timeout_s: float
    trace: Trace = field(init=False)

    def __post_init__(self) -> None:
        self.trace = Trace(self.cell, self.plan, self.settings.progress_mm / 1000.0)

    def search_contact(self) -> None:
        """Slowly along the port's axis until something is felt, or the plug is on its way in."""
        self._move(np.array([0.0, 0.0, -self.settings.contact_speed_mm_s / 1000.0]), 0.0)

        def felt() -> bool:
            last = self.trace.update()
            force = max(abs(last.axial_n), last.lateral_n)
            return force > self.settings.contact_force_n or last.depth_m > self.settings.entered_mm / 1000.0

        if not self.cell.supervisor.wait(felt, self.timeout_s):
            raise MissionFault(FaultCode.MOTION_FAILED, "no contact and no progress in the contact search")
        self.cell.do(StopMotion())

    def push_eased(self) -> Verdict:
        """Compliant push; a plug that jams is eased back and pushed again."""
        verdict = self._push()
        for _ in range(self.settings.jam_retries):
            if verdict is not Verdict.JAMMED:
                break
            self._ease()
            verdict = self._push()
        return verdict

    def search(self, verdict: Verdict) -> Verdict:
        """Lead the plug along a spiral, turning it to and fro, until it falls in; then push it home."""
        spiral, s = Spiral.of(self.settings), self.settings
        if self.trace.last.depth_m > s.search_depth_mm / 1000.0:
            return verdict
        self._comply(s.search_push_n, s.speed_limit_mm_s, ALONG_AND_TILT)
        self._watch(s.plateau_s)  # the softer push lets the plug come back a little
        begun, travelled_m, surface_m = self.trace.last.time_s, 0.0, self.trace.last.depth_m
        while travelled_m < spiral.length_m and self.trace.last.time_s - begun < s.search_s:
            seconds = self.trace.last.time_s - begun
            offset, roll = self.trace.off_axis()
            step = next_step(spiral, travelled_m, seconds, offset, roll, SEARCH_STEP_S)
            travelled_m = step.travelled_m
            self._move(np.array([*step.across_m_s, 0.0]), step.turn_rad_s)
            self._wait_step(surface_m + s.search_gain_mm / 1000.0)
            found = judge(self.trace, self.plan, s)
            if found in ENDS:
                return found
            if self.trace.last.depth_m > surface_m + s.search_gain_mm / 1000.0:
                self._move(np.zeros(3), 0.0)
                verdict = self.push_eased()
                if verdict in ENDS or self.trace.last.depth_m > s.search_depth_mm / 1000.0:
                    return verdict
                self._comply(s.search_push_n, s.speed_limit_mm_s, ALONG_AND_TILT)
        return verdict

    # --- pieces ------------------------------------------------------------------------------------------------------

    def _push(self) -> Verdict:
        self._comply(self.settings.push_force_n, self.settings.speed_limit_mm_s, ALL_AXES)
        return self._watch(self.timeout_s)

    def _ease(self) -> None:
        """Back along the axis a little, with low force, all axes yielding."""
        s = self.settings
        goal_m = self.trace.last.depth_m - s.jam_relief_mm / 1000.0
        self._comply(-s.withdraw_start_force_n, s.contact_speed_mm_s, ALL_AXES)
        self.trace.restart_stall_clock()
        self.cell.supervisor.wait(
            lambda: self.trace.update().depth_m < goal_m or self.trace.stalled(s.stall_s), self.timeout_s
        )

    def _watch(self, timeout_s: float) -> Verdict:
        """Wait for the trace to say something; GOING if it did not within ``timeout_s``."""
        self.trace.restart_stall_clock()

        def decided() -> bool:
            self.trace.update()
            return judge(self.trace, self.plan, self.settings) is not Verdict.GOING

        self.cell.supervisor.wait(decided, timeout_s)
        return judge(self.trace, self.plan, self.settings)

    def _wait_step(self, found_m: float) -> None:
        """Until the next correction is due, an overload shows, or the plug falls in."""
        due_s = self.trace.last.time_s + SEARCH_STEP_S

        def due() -> bool:
            last = self.trace.update()
            return last.time_s >= due_s or last.depth_m > found_m or judge(self.trace, self.plan, self.settings) in ENDS

        self.cell.supervisor.wait(due, self.timeout_s)

    def _move(self, velocity_m_s: Array, turn_rad_s: float) -> None:
        """A velocity (3,) and a roll in the port's frame."""
        rotate = self.plan.T_base_port.rotate
        linear, angular = rotate(velocity_m_s), rotate(np.array([0.0, 0.0, turn_rad_s]))
        self.cell.do(MoveVelocity(np.concatenate([linear, angular]), SLOWING_M_S2))

    def _comply(self, push_n: float, speed_mm_s: float, selection: Selection) -> None:
        self.cell.do(Comply(compliance(self.plan, self.settings, push_n, speed_mm_s, selection)))


Selection = tuple[bool, bool, bool, bool, bool, bool]


def compliance(
    plan: DockPlan, settings: InsertionConfig, push_n: float, speed_mm_s: float, selection: Selection = ALL_AXES
) -> Compliance:
    """Force mode in the port's frame turned into the vehicle: z is the insertion axis."""
    across = settings.lateral_speed_limit_mm_s / 1000.0
    turn = float(np.deg2rad(settings.tilt_speed_limit_deg_s))
    speeds = (across, across, speed_mm_s / 1000.0, turn, turn, turn)
    deviations = (DEVIATION_M,) * 3 + (DEVIATION_RAD,) * 3
    x, y, z, rx, ry, rz = (v if yields else d for yields, v, d in zip(selection, speeds, deviations, strict=True))
    return Compliance(
        T_base_task=Pose(plan.T_base_port.rotation @ FACING, plan.T_base_port.translation),
        selection=selection,
        wrench=(0.0, 0.0, push_n, 0.0, 0.0, 0.0),
        limits=(x, y, z, rx, ry, rz),
    )
