"""Pulling the plug out along the axis it went in on, after charging and after an insertion that failed.

The pull begins gently and grows in steps, only while nothing moves, up to its bound. A plug that does not come, that
is wedged, or whose lock is not confirmed open is left where it is, the arm stopped.
"""

from __future__ import annotations

from controller.cell import Cell
from controller.commands import Comply, StopMotion
from controller.faults import FaultCode, MissionFault
from controller.insertion import compliance
from controller.insertion_config import InsertionConfig
from controller.insertion_trace import CLEAR_M, Trace
from controller.insertion_verdict import overloaded
from controller.planning import DockPlan
from drivers.base import ChargerStatus, PlugLock, Proximity


def withdraw(cell: Cell, plan: DockPlan, settings: InsertionConfig, timeout_s: float) -> None:
    """From wherever the plug is to clear of the rim. Raises MissionFault when it does not come."""
    trace = Trace(cell, plan, settings.progress_mm / 1000.0)
    if _is_out(trace):
        return
    end_s = cell.clock.now_s() + timeout_s
    force_n = min(settings.withdraw_start_force_n, settings.withdraw_force_n)
    why = ""
    while not why:
        cell.do(Comply(compliance(plan, settings, -force_n, settings.withdraw_speed_mm_s)))
        trace.restart_stall_clock()
        cell.supervisor.wait(
            lambda: _is_out(trace) or trace.stalled(settings.stall_s) or bool(_why_stop(cell, trace, settings)),
            max(0.0, end_s - cell.clock.now_s()),
        )
        if _is_out(trace):
            cell.do(StopMotion())
            return
        why = _why_stop(cell, trace, settings)
        if not why and (force_n >= settings.withdraw_force_n or cell.clock.now_s() >= end_s):
            why = f"the plug does not move with {force_n:.0f} N"
        force_n = min(force_n + settings.withdraw_step_n, settings.withdraw_force_n)
    cell.do(StopMotion())
    raise MissionFault(FaultCode.WITHDRAWAL_BLOCKED, f"{why} at {trace.last.depth_m * 1000:.1f} mm depth")


def _is_out(trace: Trace) -> bool:
    return trace.update().depth_m < -CLEAR_M


def _why_stop(cell: Cell, trace: Trace, settings: InsertionConfig) -> str:
    """What forbids to go on pulling; empty if nothing does."""
    if overloaded(trace, settings):
        return f"{trace.last.axial_n:.0f} N, {trace.last.lateral_n:.0f} N lateral, {trace.last.moment_nm:.1f} Nm"
    if not cell.charger_says(_lets_go):
        return "the plug is not known to be unlocked"
    return ""


def _lets_go(charger: ChargerStatus) -> bool:
    return charger.proximity is Proximity.ABSENT or charger.lock is PlugLock.UNLOCKED
