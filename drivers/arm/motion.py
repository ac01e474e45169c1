"""What became of the last motion: the script's word for it, checked against where the arm really is."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.arm import messages as m
from drivers.base import ArmState, MotionProgress, SafetyMode
from perception.geometry import Pose

ARRIVED_M, ARRIVED_RAD = 0.001, 0.005
SETTLE_S = 0.5
"""A motion that the script calls done must be at its target, at rest, within this time."""


@dataclass(slots=True)
class _Motion:
    motion_id: int
    target: Pose
    stopped: bool = False
    outcome: MotionProgress | None = None


class MotionTracker:
    """Follows one motion at a time."""

    def __init__(self) -> None:
        self._count = 0
        self._motion: _Motion | None = None

    def next_id(self) -> int:
        """Number for a motion about to be asked for; from 1 up."""
        self._count += 1
        return self._count

    def begin(self, motion_id: int, target: Pose) -> None:
        """The controller accepted the motion with ``T_base_tcp`` as its target."""
        self._motion = _Motion(motion_id, target)

    def stop_asked(self) -> None:
        """A stop was asked for: an unfinished motion will not reach its target."""
        motion = self._motion
        if motion is not None and motion.outcome is None:
            motion.stopped = True

    def forget(self) -> None:
        """The links are made anew: whatever was under way has failed."""
        motion = self._motion
        if motion is not None and motion.outcome is None:
            motion.outcome = MotionProgress(motion.motion_id, False, True, "ended by a restart of the control link")

    def progress(self, status: m.Status, since_s: float, state: ArmState | None, over: str | None) -> MotionProgress:
        """The last motion's progress, from the worker's status (known ``since_s``) and the newest sample.

        ``over``: why no motion can go on, whatever the worker said last.
        """
        motion = self._motion
        if motion is None:
            return MotionProgress(0, running=False, failed=False, detail="no motion yet")
        if motion.outcome is None:
            motion.outcome = _outcome(motion, status, since_s, state, over)
        return motion.outcome or MotionProgress(motion.motion_id, True, False, _hint(state))


def _outcome(
    motion: _Motion, status: m.Status, since_s: float, state: ArmState | None, over: str | None
) -> MotionProgress | None:
    """How the motion ended, or None while it runs."""

    def failed(detail: str) -> MotionProgress:
        return MotionProgress(motion.motion_id, False, True, detail)

    if over is not None:
        return failed(over)
    if status.motion_id != motion.motion_id or status.phase in ("running", "stopping"):
        return None  # the worker's word on this motion is still on its way, or it runs
    if status.phase == "failed":
        safety = "" if state is None or state.safety <= SafetyMode.REDUCED else f" ({state.safety.name})"
        return failed(f"the control script ended during the motion{safety}")
    if state is None or state.time_s < since_s:
        return None
    settling = state.time_s - since_s < SETTLE_S
    if state.moving and settling:
        return None
    if motion.stopped:
        return failed("stopped on the way")
    off_m = state.T_base_tcp.distance_to(motion.target)
    off_rad = state.T_base_tcp.angle_to(motion.target)
    if off_m <= ARRIVED_M and off_rad <= ARRIVED_RAD:
        return MotionProgress(motion.motion_id, running=False, failed=False)
    if settling:
        return None
    return failed(f"ended {1000 * off_m:.1f} mm and {off_rad:.3f} rad from its target")


def _hint(state: ArmState | None) -> str:
    """Why a motion may make no headway."""
    if state is not None and state.speed_scaling == 0.0:
        return "the speed slider is at 0"
    return ""
