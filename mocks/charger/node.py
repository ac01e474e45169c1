"""The charger's control unit: requests answered, states and measured values told. No bus, no clock.

The rules are those of docs/can.md: power only with a locked, mated plug and a living robot; the plug stays locked
while anything is live. What happens by itself is in ``process``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mocks.charger import plug_lock
from mocks.charger.plug_lock import LockActuator
from mocks.charger.power import PowerStage
from mocks.charger.process import LIVE, ChargerProcess, NodeSettings
from mocks.charger.supervision import RobotView

_log = logging.getLogger(__name__)
_INHIBITED = ("Init", "Fault", "EStop", *LIVE)
_DEAD_A = 1.0


@dataclass(frozen=True, slots=True)
class Answer:
    """AckResult and, for a rejection, its reason."""

    result: str
    reason: str = "None"


DONE, ACCEPTED, BUSY = Answer("Done"), Answer("Accepted"), Answer("Busy")


class ChargerNode:
    """One charger. ``step`` moves emulated time on, ``command`` takes a request, the rest can be read."""

    def __init__(self, settings: NodeSettings | None = None) -> None:
        self.settings = settings or NodeSettings()
        self.process = ChargerProcess(self.settings)
        self.ack_sequence = 0
        self.answer = Answer("None")
        self.reject_next: str | None = None
        """Name of the request that is refused once, whatever the state: a fault to inject."""
        self._pending: Callable[[], Answer | None] | None = None

    @property
    def state(self) -> str:
        """Name of the state, as in the DBC."""
        return self.process.state

    @property
    def lock(self) -> LockActuator:
        """The plug's lock."""
        return self.process.lock

    @property
    def power(self) -> PowerStage:
        """Contactor, voltage and current."""
        return self.process.power

    def step(self, now_s: float, plugged: bool, estop: bool, robot: RobotView) -> None:
        """Move on to an emulated time, with what is sensed now."""
        cut = self.process.step(now_s, plugged, estop, robot)
        if self._pending is not None and (answer := Answer("Failed") if cut else self._pending()) is not None:
            self.answer, self._pending = answer, None

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
        if self.process.estop or self.state == "EStop":
            return Answer("Rejected", "EStopActive")
        if self.state == "Fault":
            return Answer("Rejected", "FaultActive")
        if not self.process.robot.alive:
            return Answer("Rejected", "RobotNotHeard")
        return None if self.state in states else Answer("Rejected", "WrongState")

    def _reserve(self, _: int) -> Answer:
        refusal = self._refusal("Idle", "Reserved")
        if refusal is None:
            self.process.robot_loss_latched = False
            self.process.enter("Reserved")
        return refusal or DONE

    def _unlock_dock(self, _: int) -> Answer:
        refusal = self._refusal("Reserved", "Ready")
        if refusal:
            return refusal
        start_s = self.process.now_s

        def released() -> Answer | None:
            if self.process.now_s - start_s < self.settings.dock_travel_s:
                return None
            self.process.enter("Ready")
            return DONE

        self._pending = released
        return ACCEPTED

    def _lock_plug(self, _: int) -> Answer:
        refusal = self._refusal("Ready")
        if refusal:
            return refusal
        if not self.process.plugged:
            return Answer("Rejected", "NoPlug")
        if self.lock.moving:
            return BUSY
        self.lock.lock(self.process.now_s)
        self._pending = lambda: self._lock_answer(plug_lock.LOCKED)
        return ACCEPTED

    def _enable_power(self, limit_a: int) -> Answer:
        refusal = self._refusal("Ready")
        if refusal:
            return refusal
        if not self.process.plugged:
            return Answer("Rejected", "NoPlug")
        if self.lock.state != plug_lock.LOCKED:
            return Answer("Rejected", "NotLocked")
        if not self.process.robot.mated:
            return Answer("Rejected", "NotMated")
        largest = self.settings.power.max_current_a
        self.power.limit_a = min(largest, limit_a) if limit_a else largest
        self.process.enter("Handshake")
        self._pending = lambda: {"Charging": DONE, "Handshake": None, "PreCharge": None}.get(
            self.state, Answer("Failed")
        )
        return ACCEPTED

    def _stop_power(self, _: int) -> Answer:
        self.process.wind_down()
        if not self.process.live:
            return Answer("Failed") if self.power.contactor_closed else DONE
        self._pending = lambda: {"Stopping": None, "Finished": DONE}.get(self.state, Answer("Failed"))
        return ACCEPTED

    def _unlock_plug(self, _: int) -> Answer:
        if self.process.live or self.power.contactor_closed or abs(self.power.current_a) >= _DEAD_A:
            return Answer("Rejected", "PowerNotOff")
        refusal = self._refusal("Idle", "Reserved", "Ready", "Finished")
        if refusal:
            return refusal
        if self.lock.moving:
            return BUSY
        self.lock.unlock(self.process.now_s)
        self._pending = lambda: self._lock_answer(plug_lock.UNLOCKED)
        return ACCEPTED

    def _release(self, _: int) -> Answer:
        refusal = self._refusal("Idle", "Reserved", "Ready", "Finished")
        if refusal:
            return refusal
        if self.lock.state != plug_lock.UNLOCKED:
            return Answer("Rejected", "WrongState")
        self.process.enter("Idle")
        return DONE

    def _reset_fault(self, _: int) -> Answer:
        if self.process.estop:
            return Answer("Rejected", "EStopActive")
        if self.power.contactor_closed and not self.process.live:
            return Answer("Rejected", "PowerNotOff")
        if not self.process.robot.alive:
            return Answer("Rejected", "RobotNotHeard")
        self.process.robot_loss_latched = False
        if self.state in ("Fault", "EStop"):
            self.process.fault = "None"
            self.process.enter("Finished" if self.lock.holds else "Idle")
        return DONE

    def _abort(self, _: int) -> Answer:
        if self.process.live:
            return self._stop_power(0)
        if self.state in ("Reserved", "Ready"):
            self.process.enter("Finished" if self.lock.holds else "Idle")
        return DONE

    def _lock_answer(self, end: str) -> Answer | None:
        if self.lock.state == plug_lock.FAULT:
            self.process.fault = "LockJammed"
            return Answer("Failed")
        if self.lock.state == end:
            self.process.fault = "None" if self.process.fault == "LockJammed" else self.process.fault
            return DONE
        return None

    # --- what it says -------------------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Signals of CH_Status."""
        dock = self.state == "Ready" and self.process.robot.alive and not self.process.robot_loss_latched
        inhibit = self.state in _INHIBITED or not self.process.robot.alive or self.process.robot_loss_latched
        rejected = self.answer.result == "Rejected" and self.process.fault == "None"
        return {
            "State": self.state,
            "PlugLock": self.lock.state,
            "Prox": self._proximity(),
            "Pilot": self._pilot(),
            "ContactorClosed": int(self.power.contactor_closed),
            "DockEnable": int(dock),
            "MotionInhibit": int(inhibit),
            "EStop": int(self.process.estop),
            "AckSeq": self.ack_sequence,
            "AckResult": self.answer.result,
            "FaultCode": self.answer.reason if rejected else self.process.fault,
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
        if not self.process.plugged:
            return "Absent"
        if self.process.release_pressed:
            return "ReleasePressed"
        return "Latched" if self.lock.state == plug_lock.LOCKED else "Inserted"

    def _pilot(self) -> str:
        """Control pilot as IEC 61851-1 names its states: what the vehicle and the charger make of the line."""
        if self.state == "EStop":
            return "E"
        if self.state in ("Fault", "Init"):
            return "F"
        if not self.process.plugged:
            return "A"
        energy = self.state in ("PreCharge", "Charging", "Paused")
        return ("D" if self.process.ventilation else "C") if energy else "B"
