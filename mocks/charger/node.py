"""The charger's control unit as a state machine: requests in, states and measured values out. No bus, no clock.

The rules are those of docs/can.md: power only with a locked, mated plug and a living robot; the plug stays locked
while anything is live; a silent robot stops what must not go on alone.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mocks.charger import plug_lock
from mocks.charger.plug_lock import LockActuator
from mocks.charger.power import PowerSettings, PowerStage
from mocks.charger.supervision import RobotView

_log = logging.getLogger(__name__)
_LIVE = ("Handshake", "PreCharge", "Charging", "Paused", "Stopping")
_INHIBITED = ("Init", "Fault", "EStop", *_LIVE)
_CUT_A = 5.0
_DEAD_A = 1.0


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """Durations in emulated seconds."""

    power: PowerSettings = field(default_factory=PowerSettings)
    boot_s: float = 0.2
    dock_travel_s: float = 0.3
    lock_travel_s: float = 0.6
    weld_check_s: float = 0.5


@dataclass(frozen=True, slots=True)
class Answer:
    """AckResult and, for a rejection, its reason."""

    result: str
    reason: str = "None"


DONE, ACCEPTED, BUSY = Answer("Done"), Answer("Accepted"), Answer("Busy")
WAITING_FOR_ROBOT = RobotView(alive=False, lost=False)


class ChargerNode:
    """One charger. ``step`` moves emulated time on, ``command`` takes a request, the rest can be read."""

    def __init__(self, settings: NodeSettings | None = None) -> None:
        self.settings = settings or NodeSettings()
        self.lock = LockActuator(self.settings.lock_travel_s)
        self.power = PowerStage(self.settings.power)
        self.state = "Init"
        self.fault = "None"
        self.ack_sequence = 0
        self.answer = Answer("None")
        self.reject_next: str | None = None
        """Name of the request that is refused once, whatever the state: a fault to inject."""
        self.paused = False
        self.ventilation = False
        self._robot = WAITING_FOR_ROBOT
        self._plugged = False
        self._estop = False
        self._robot_loss_latched = False
        self._then_fault: str | None = None
        self._now_s: float | None = None
        self._entered_s = 0.0
        self._pending: Callable[[], Answer | None] | None = None

    # --- requests -----------------------------------------------------------------------------------------------

    def command(self, name: str, sequence: int, argument: int) -> None:
        """Act once on a new sequence number; a repeat only counts while the answer was "busy"."""
        repeat = sequence == self.ack_sequence and self.answer.result not in ("None", "Busy")
        if name == "None" or repeat:
            return
        self.ack_sequence = sequence
        if name == self.reject_next:
            self.reject_next, self.answer = None, Answer("Rejected", "WrongState")
            return
        handler = self._handlers().get(name)
        self._pending = None if handler else self._pending
        self.answer = handler(argument) if handler else Answer("Rejected", "UnknownCommand")
        _log.info("%s #%d: %s %s", name, sequence, self.answer.result, self.answer.reason)

    def _handlers(self) -> dict[str, Callable[[int], Answer]]:
        return {
            "Reserve": self._reserve,
            "UnlockDock": self._unlock_dock,
            "LockPlug": self._lock_plug,
            "EnablePower": self._enable_power,
            "StopPower": self._stop_power,
            "UnlockPlug": self._unlock_plug,
            "Release": self._release,
            "ResetFault": self._reset_fault,
            "Abort": self._abort,
        }

    def _refusal(self, *states: str) -> Answer | None:
        """Why a request that needs a living robot and one of these states is refused."""
        if self._estop or self.state == "EStop":
            return Answer("Rejected", "EStopActive")
        if self.state == "Fault":
            return Answer("Rejected", "FaultActive")
        if not self._robot.alive:
            return Answer("Rejected", "RobotNotHeard")
        return None if self.state in states else Answer("Rejected", "WrongState")

    def _reserve(self, _: int) -> Answer:
        refusal = self._refusal("Idle", "Reserved")
        if refusal is None:
            self._robot_loss_latched = False
            self._enter("Reserved")
        return refusal or DONE

    def _unlock_dock(self, _: int) -> Answer:
        refusal = self._refusal("Reserved", "Ready")
        if refusal:
            return refusal
        start_s = self._now_s or 0.0

        def released() -> Answer | None:
            if (self._now_s or 0.0) - start_s < self.settings.dock_travel_s:
                return None
            self._enter("Ready")
            return DONE

        self._pending = released
        return ACCEPTED

    def _lock_plug(self, _: int) -> Answer:
        refusal = self._refusal("Ready")
        if refusal:
            return refusal
        if not self._plugged:
            return Answer("Rejected", "NoPlug")
        if self.lock.moving:
            return BUSY
        self.lock.lock(self._now_s or 0.0)
        self._pending = lambda: self._lock_answer(plug_lock.LOCKED)
        return ACCEPTED

    def _enable_power(self, limit_a: int) -> Answer:
        refusal = self._refusal("Ready")
        if refusal:
            return refusal
        if not self._plugged:
            return Answer("Rejected", "NoPlug")
        if self.lock.state != plug_lock.LOCKED:
            return Answer("Rejected", "NotLocked")
        if not self._robot.mated:
            return Answer("Rejected", "NotMated")
        largest = self.settings.power.max_current_a
        self.power.limit_a = min(largest, limit_a) if limit_a else largest
        self._enter("Handshake")
        self._pending = lambda: {"Charging": DONE, "Handshake": None, "PreCharge": None}.get(
            self.state, Answer("Failed")
        )
        return ACCEPTED

    def _stop_power(self, _: int) -> Answer:
        self._wind_down()
        if self.state not in _LIVE:
            return Answer("Failed") if self.power.contactor_closed else DONE
        self._pending = lambda: {"Stopping": None, "Finished": DONE}.get(self.state, Answer("Failed"))
        return ACCEPTED

    def _unlock_plug(self, _: int) -> Answer:
        if self.state in _LIVE or self.power.contactor_closed or abs(self.power.current_a) >= _DEAD_A:
            return Answer("Rejected", "PowerNotOff")
        refusal = self._refusal("Idle", "Reserved", "Ready", "Finished")
        if refusal:
            return refusal
        if self.lock.moving:
            return BUSY
        self.lock.unlock(self._now_s or 0.0)
        self._pending = lambda: self._lock_answer(plug_lock.UNLOCKED)
        return ACCEPTED

    def _release(self, _: int) -> Answer:
        refusal = self._refusal("Idle", "Reserved", "Ready", "Finished")
        if refusal:
            return refusal
        if self.lock.state != plug_lock.UNLOCKED:
            return Answer("Rejected", "WrongState")
        self._enter("Idle")
        return DONE

    def _reset_fault(self, _: int) -> Answer:
        if self._estop:
            return Answer("Rejected", "EStopActive")
        if self.power.contactor_closed and self.state not in _LIVE:
            return Answer("Rejected", "PowerNotOff")
        if not self._robot.alive:
            return Answer("Rejected", "RobotNotHeard")
        self._robot_loss_latched = False
        if self.state in ("Fault", "EStop"):
            self.fault = "None"
            self._enter("Finished" if self.lock.holds else "Idle")
        return DONE

    def _abort(self, _: int) -> Answer:
        if self.state in _LIVE:
            return self._stop_power(0)
        if self.state in ("Reserved", "Ready"):
            self._enter("Finished" if self.lock.holds else "Idle")
        return DONE

    def _lock_answer(self, end: str) -> Answer | None:
        if self.lock.state == plug_lock.FAULT:
            self.fault = "LockJammed"
            return Answer("Failed")
        if self.lock.state == end:
            self.fault = "None" if self.fault == "LockJammed" else self.fault
            return DONE
        return None

    # --- time ---------------------------------------------------------------------------------------------------

    def step(self, now_s: float, plugged: bool, estop: bool, robot: RobotView) -> None:
        """Move on to an emulated time, with what is sensed now."""
        dt_s = 0.0 if self._now_s is None else max(0.0, now_s - self._now_s)
        self._now_s, self._plugged, self._estop, self._robot = now_s, plugged, estop, robot
        self.lock.step(now_s)
        self._guard()
        self._advance(now_s)
        charging = self.state == "Charging" and not self.paused
        self.power.step(
            dt_s,
            wanted_v=self.settings.power.battery_v if self.state == "PreCharge" else 0.0,
            wanted_a=self.power.limit_a if charging else 0.0,
        )
        if self._pending is not None and (answer := self._pending()) is not None:
            self.answer, self._pending = answer, None

    def _guard(self) -> None:
        """What ends everything else: emergency stop, a plug pulled under power, heat, a robot that fell silent."""
        if self._estop and self.state != "EStop":
            self._cut("EStop", "EStopPressed")
        elif self.power.contactor_closed and not self._plugged and self.state != "Fault":
            self._cut("Fault", "UnpluggedUnderPower")
        elif self.power.temperature_c > self.settings.power.hot_c and self.state in ("Charging", "Paused"):
            self._wind_down("OverTemperature")
        if self._robot.lost and self.state not in ("Init", "Idle"):
            self._robot_loss_latched = True
            if self.state in _LIVE and (self._robot.holds_plug or not self._robot.clear):
                self._wind_down("RobotLost")

    def _advance(self, now_s: float) -> None:
        since_s = now_s - self._entered_s
        match self.state:
            case "Init" if since_s >= self.settings.boot_s:
                self._enter("Idle")
            case "Handshake" if since_s >= self.settings.power.handshake_s:
                self._enter("PreCharge")
            case "PreCharge" if self.power.precharged:
                self.power.contactor_closed = True
                self._enter("Charging")
            case "Charging" if self.paused:
                self._enter("Paused")
            case "Paused" if not self.paused:
                self._enter("Charging")
            case "Charging" if self.power.full:
                self._wind_down()
            case "Stopping" if self.power.current_a < _CUT_A:
                self._stopped(since_s)

    def _stopped(self, since_s: float) -> None:
        self.power.open_contactor()
        if not self.power.contactor_closed:
            fault, self._then_fault = self._then_fault, None
            self._enter("Fault" if fault else "Finished")
            self.fault = fault or self.fault
        elif since_s > self.settings.weld_check_s:
            self._enter("Fault")
            self.fault = "ContactorWelded"

    def _wind_down(self, fault: str | None = None) -> None:
        """Ramp the current down, then open the contactor; the plug stays locked."""
        if self.state not in _LIVE:
            return
        self._then_fault = self._then_fault or fault
        if self.state != "Stopping":
            self._enter("Stopping")

    def _cut(self, state: str, fault: str) -> None:
        """Open the contactor at once."""
        self.power.open_contactor()
        self.fault = fault
        self._enter(state)
        if self._pending is not None:
            self.answer, self._pending = Answer("Failed"), None

    def _enter(self, state: str) -> None:
        if state != self.state:
            _log.info("%s -> %s", self.state, state)
            self.state, self._entered_s = state, self._now_s or 0.0

    # --- what it says -------------------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Signals of CH_Status."""
        dock = self.state == "Ready" and self._robot.alive and not self._robot_loss_latched
        inhibit = self.state in _INHIBITED or not self._robot.alive or self._robot_loss_latched
        rejected = self.answer.result == "Rejected" and self.fault == "None"
        return {
            "State": self.state,
            "PlugLock": self.lock.state,
            "Prox": self._proximity(),
            "Pilot": self._pilot(),
            "ContactorClosed": int(self.power.contactor_closed),
            "DockEnable": int(dock),
            "MotionInhibit": int(inhibit),
            "EStop": int(self._estop),
            "AckSeq": self.ack_sequence,
            "AckResult": self.answer.result,
            "FaultCode": self.answer.reason if rejected else self.fault,
        }

    def electrical(self) -> dict[str, Any]:
        """Signals of CH_Electrical."""
        return {
            "Voltage": round(self.power.voltage_v, 1),
            "Current": round(self.power.current_a, 1),
            "TempDC": round(self.power.temperature_c),
            "SoC": round(2.0 * self.power.charge_percent) / 2.0,
        }

    def _proximity(self) -> str:
        if not self._plugged:
            return "Absent"
        return "Latched" if self.lock.state == plug_lock.LOCKED else "Inserted"

    def _pilot(self) -> str:
        """Control pilot as IEC 61851-1 names its states: what the vehicle and the charger make of the line."""
        if self.state == "EStop":
            return "E"
        if self.state in ("Fault", "Init"):
            return "F"
        if not self._plugged:
            return "A"
        energy = self.state in ("PreCharge", "Charging", "Paused")
        return ("D" if self.ventilation else "C") if energy else "B"
