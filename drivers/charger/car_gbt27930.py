"""GB/T 27930-2015, listening only: what charger and vehicle say to each other through the plug's own CAN.

Charging is what the *vehicle* says: it wants current (BCL), measures current (BCS), and neither side has ended it
(BST, CST). The charger's frames (CCS) count only for its permission. Currents are sent negative into the vehicle.
"""

from __future__ import annotations

import math
from collections import Counter

from drivers.base import CarPhase, CarStatus
from drivers.charger.car_messages import NewestMessages
from drivers.charger.car_transport import CONNECTION_PF, DATA_PF, Identifier, Transport

CHARGER, VEHICLE = 0x56, 0xF4
_FAST_S, _SLOW_S = 1.0, 5.0
"""The standard's own time-outs: of BCL and CCS, and of everything slower."""
_FLOWING_A = 1.0
_REASONS = {
    "BST": ("WantedSoC", "WantedVoltage", "WantedCellVoltage", "ChargerStopped"),
    "CST": ("ConditionReached", "Manual", "Fault", "VehicleStopped"),
}


class Gbt27930:
    """The decoder: frames in, the vehicle's status out. Times are passed in."""

    bitrate = 250_000
    name = "gbt27930"

    def __init__(self) -> None:
        self._newest = NewestMessages("gbt27930.dbc")
        self._transport = Transport()
        self._messages = {
            (about.pgn, about.source): message
            for message in self._newest.database.messages
            if (about := Identifier.of(message.frame_id))
        }

    @property
    def counters(self) -> Counter[str]:
        """What became of the frames."""
        transport = {f"transport_{name}": count for name, count in self._transport.counters.items()}
        return self._newest.counters + Counter(transport)

    def take(self, identifier: int, extended: bool, data: bytes, now_s: float) -> None:
        """One data frame of the bus."""
        about = Identifier.of(identifier)
        if not extended or {about.source, about.destination} - {CHARGER, VEHICLE, 0xFF}:
            self._newest.counters["foreign_frames"] += 1
            return
        pgn = about.pgn
        if pgn >> 8 in (CONNECTION_PF, DATA_PF):
            whole = self._transport.take(about, data, now_s)
            if whole is None:
                return
            pgn, data = whole
        message = self._messages.get((pgn, about.source))
        if message is None:
            self._newest.counters["foreign_frames"] += 1
        else:
            self._newest.take(message, data, now_s)

    def status(self, now_s: float) -> CarStatus:
        """How the vehicle stands now."""
        value = self._newest.value
        current_a = -value("BCS", "Current", now_s, _SLOW_S)
        return CarStatus(
            time_s=self._newest.newest_s,
            protocol=self.name,
            phase=self._phase(now_s, current_a),
            voltage_v=value("BCS", "Voltage", now_s, _SLOW_S),
            current_a=current_a,
            wanted_current_a=-value("BCL", "WantedCurrent", now_s, _FAST_S),
            charge_percent=value("BCS", "SoC", now_s, _SLOW_S),
            reason=self._reason(now_s),
        )

    def _phase(self, now_s: float, current_a: float) -> CarPhase:
        if now_s - self._newest.newest_s > _SLOW_S:
            return CarPhase.SILENT
        last_wish_s = self._newest.heard_s("BCL")
        end_s = max(self._newest.heard_s(name) for name in ("BST", "CST", "BSD", "CSD"))
        if now_s - end_s <= _SLOW_S and end_s >= last_wish_s - _FAST_S:
            return CarPhase.ENDING
        wanted = now_s - last_wish_s <= _FAST_S
        permitted = self._newest.value("CCS", "Permitted", now_s, _FAST_S) == 1
        flowing = math.isfinite(current_a) and current_a >= _FLOWING_A
        return CarPhase.CHARGING if wanted and permitted and flowing else CarPhase.PREPARING

    def _reason(self, now_s: float) -> str:
        said = [
            f"{message}.{signal}"
            for message, signals in _REASONS.items()
            for signal in signals
            if self._newest.value(message, signal, now_s, _SLOW_S) == 1
        ]
        return ", ".join(said)
