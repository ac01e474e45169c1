"""The power electronics: pre-charge to battery voltage, contactor, current ramps, temperature, charge."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PowerSettings:
    """A small DC charger on a 400 V battery, in emulated seconds."""

    battery_v: float = 400.0
    battery_kwh: float = 60.0
    start_percent: float = 40.0
    max_current_a: float = 125.0
    ramp_up_a_s: float = 50.0
    ramp_down_a_s: float = 200.0
    precharge_v_s: float = 400.0
    handshake_s: float = 0.5
    longest_precharge_s: float = 5.0
    ambient_c: float = 22.0
    heating_c_a2: float = 0.0014
    """Final rise of the contact's temperature for each ampere squared."""
    heating_time_s: float = 400.0
    hot_c: float = 90.0


class PowerStage:
    """Voltage and current that follow what is wanted of them."""

    def __init__(self, settings: PowerSettings) -> None:
        self.settings = settings
        self.contactor_closed = False
        self.welded = False
        self.precharge_fails = False
        self.voltage_v = 0.0
        self.current_a = 0.0
        self.limit_a = settings.max_current_a
        self.temperature_c = settings.ambient_c
        self.charge_percent = settings.start_percent

    @property
    def precharged(self) -> bool:
        """The plug's voltage is near the battery's."""
        return self.voltage_v >= self.settings.battery_v - 20.0

    @property
    def full(self) -> bool:
        """The vehicle wants no more."""
        return self.charge_percent >= 100.0

    def open_contactor(self) -> None:
        """Open it, at whatever current; a welded one stays."""
        self.contactor_closed = self.contactor_closed and self.welded

    def step(self, dt_s: float, wanted_v: float, wanted_a: float) -> None:
        """Move on by ``dt_s`` towards a voltage (contactor open) and a current (contactor closed)."""
        s = self.settings
        if self.contactor_closed:
            self.voltage_v = s.battery_v + 0.05 * self.current_a
            rate = s.ramp_up_a_s if wanted_a > self.current_a else s.ramp_down_a_s
            self.current_a = _towards(self.current_a, wanted_a, rate * dt_s)
        else:
            self.current_a = 0.0
            wanted_v = 0.0 if self.precharge_fails else wanted_v
            self.voltage_v = _towards(self.voltage_v, wanted_v, s.precharge_v_s * dt_s)
        warm_c = s.ambient_c + s.heating_c_a2 * self.current_a**2
        self.temperature_c += (warm_c - self.temperature_c) * min(1.0, dt_s / s.heating_time_s)
        energy_kwh = self.voltage_v * self.current_a * dt_s / 3.6e6
        self.charge_percent = min(100.0, self.charge_percent + 100.0 * energy_kwh / s.battery_kwh)


def _towards(value: float, target: float, step: float) -> float:
    return min(target, value + step) if target > value else max(target, value - step)
