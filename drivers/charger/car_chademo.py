"""CHAdeMO, listening only: what charger and vehicle say to each other through the plug's own CAN.

Charging is what the *vehicle* says: charging enabled, its contactor closed, current wanted, no fault and no wish to
end. The current itself is measured by the charger alone in this protocol; it is shown, and must flow.
"""

from __future__ import annotations

from collections import Counter

from drivers.base import CarPhase, CarStatus
from drivers.charger.car_messages import NewestMessages

_FRESH_S = 1.0
_FLOWING_A = 1.0
_FAULTS = ("OverVoltage", "UnderVoltage", "CurrentDeviation", "HighTemperature", "VoltageDeviation", "SystemFault")


class Chademo:
    """The decoder: frames in, the vehicle's status out. Times are passed in."""

    bitrate = 500_000
    name = "chademo"

    def __init__(self) -> None:
        self._newest = NewestMessages("chademo.dbc")
        self._messages = {message.frame_id: message for message in self._newest.database.messages}

    @property
    def counters(self) -> Counter[str]:
        """What became of the frames."""
        return self._newest.counters.copy()

    def take(self, identifier: int, extended: bool, data: bytes, now_s: float) -> None:
        """One data frame of the bus."""
        message = None if extended else self._messages.get(identifier)
        if message is None:
            self._newest.counters["foreign_frames"] += 1
        elif len(data) != message.length:
            self._newest.counters["bad_frames"] += 1
        else:
            self._newest.take(message, data, now_s)

    def status(self, now_s: float) -> CarStatus:
        """How the vehicle stands now."""
        return CarStatus(
            time_s=self._newest.newest_s,
            protocol=self.name,
            phase=self._phase(now_s),
            voltage_v=self._newest.value("ChargerStatus", "Voltage", now_s, _FRESH_S),
            current_a=self._newest.value("ChargerStatus", "Current", now_s, _FRESH_S),
            wanted_current_a=self._vehicle("WantedCurrent", now_s),
            charge_percent=self._vehicle("ChargedRate", now_s),
            reason=", ".join(name for name in ("StopRequest", *_FAULTS) if self._vehicle(name, now_s) == 1),
        )

    def _vehicle(self, signal: str, now_s: float) -> float:
        return self._newest.value("VehicleStatus", signal, now_s, _FRESH_S)

    def _phase(self, now_s: float) -> CarPhase:
        if now_s - self._newest.heard_s("VehicleStatus") > _FRESH_S:
            return CarPhase.SILENT
        if any(self._vehicle(name, now_s) == 1 for name in ("StopRequest", *_FAULTS)):
            return CarPhase.ENDING
        willing = self._vehicle("ChargingEnabled", now_s) == 1 and self._vehicle("ContactorOpen", now_s) == 0
        wanted = self._vehicle("WantedCurrent", now_s) >= _FLOWING_A
        flowing = self._newest.value("ChargerStatus", "Current", now_s, _FRESH_S) >= _FLOWING_A
        return CarPhase.CHARGING if willing and wanted and flowing else CarPhase.PREPARING
