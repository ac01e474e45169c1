"""What goes on in the charger by itself: states in time, the guards that end them, lock and power behind them.

No requests here (see ``node``), no bus, no clock: emulated time and what is sensed are handed in.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

from mocks.charger.plug_lock import LockActuator
from mocks.charger.power import PowerSettings, PowerStage
from mocks.charger.supervision import RobotView

_log = logging.getLogger(__name__)
LIVE = ("Handshake", "PreCharge", "Charging", "Paused", "Stopping")
_CUT_A = 5.0


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """Durations in emulated seconds."""

    power: PowerSettings = field(default_factory=PowerSettings)
    boot_s: float = 0.2
    dock_travel_s: float = 0.3
    lock_travel_s: float = 0.6
    weld_check_s: float = 0.5


class ChargerProcess:
    """State, lock, contactor and current, and what is sensed of plug, emergency stop and robot."""

    def __init__(self, settings: NodeSettings) -> None:
        self.settings = settings
        self.lock = LockActuator(settings.lock_travel_s)
        self.power = PowerStage(settings.power)
        self.state = "Init"
        self.fault = "None"
        self.paused = False
        self.ventilation = False
        self.release_pressed = False
        self.plugged = False
        self.estop = False
        self.robot = RobotView(alive=False, lost=False)
        self.robot_loss_latched = False
        self.now_s = 0.0
        self._started = False
        self._entered_s = 0.0
        self._then_fault: str | None = None

    @property
    def live(self) -> bool:
        """Power is on, coming or going."""
        return self.state in LIVE

    def step(self, now_s: float, plugged: bool, estop: bool, robot: RobotView) -> bool:
        """Move on to an emulated time. True if everything was cut off at once."""
        dt_s = max(0.0, now_s - self.now_s) if self._started else 0.0
        self._started, self.now_s, self.plugged, self.estop, self.robot = True, now_s, plugged, estop, robot
        self.lock.step(now_s)
        cut = self._guard()
        self._advance(now_s - self._entered_s)
        self.power.step(
            dt_s,
            wanted_v=self.settings.power.battery_v if self.state == "PreCharge" else 0.0,
            wanted_a=self.power.limit_a if self.state == "Charging" and not self.paused else 0.0,
        )
        return cut

    def _guard(self) -> bool:
        """What ends everything else: emergency stop, a plug pulled under power, heat, a robot that fell silent."""
        cut = True
        if self.estop and self.state != "EStop":
            self._cut("EStop", "EStopPressed")
        elif self.power.contactor_closed and not self.plugged and self.state != "Fault":
            self._cut("Fault", "UnpluggedUnderPower")
        else:
            cut = False
        if self.power.temperature_c > self.settings.power.hot_c and self.state in ("Charging", "Paused"):
            self.wind_down("OverTemperature")
        if self.release_pressed and self.live:
            self.wind_down()
        if self.robot.lost and self.state not in ("Init", "Idle"):
            self.robot_loss_latched = True
            if self.live and (self.robot.holds_plug or not self.robot.clear):
                self.wind_down("RobotLost")
        return cut

    def _advance(self, since_s: float) -> None:
        match self.state:
            case "Init" if since_s >= self.settings.boot_s:
                self.enter("Idle")
            case "Handshake" if since_s >= self.settings.power.handshake_s:
                self.enter("PreCharge")
            case "PreCharge" if self.power.precharged:
                self.power.contactor_closed = True
                self.enter("Charging")
            case "PreCharge" if since_s >= self.settings.power.longest_precharge_s:
                self._cut("Fault", "PreChargeFailed")
            case "Charging" if self.paused:
                self.enter("Paused")
            case "Paused" if not self.paused:
                self.enter("Charging")
            case "Charging" if self.power.full:
                self.wind_down()
            case "Stopping" if self.power.current_a < _CUT_A:
                self._stopped(since_s)

    def _stopped(self, since_s: float) -> None:
        self.power.open_contactor()
        if not self.power.contactor_closed:
            fault, self._then_fault = self._then_fault, None
            self.enter("Fault" if fault else "Finished")
            self.fault = fault or self.fault
        elif since_s > self.settings.weld_check_s:
            self.enter("Fault")
            self.fault = "ContactorWelded"

    def wind_down(self, fault: str | None = None) -> None:
        """Ramp the current down, then open the contactor; the plug stays locked. Afterwards ``fault``, if any."""
        if not self.live:
            return
        self._then_fault = self._then_fault or fault
        if self.state != "Stopping":
            self.enter("Stopping")

    def _cut(self, state: str, fault: str) -> None:
        """Open the contactor at once."""
        self.power.open_contactor()
        self.fault = fault
        self.enter(state)

    def enter(self, state: str) -> None:
        """Change state."""
        if state != self.state:
            _log.info("%s -> %s", self.state, state)
            self.state, self._entered_s = state, self.now_s
