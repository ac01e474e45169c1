"""Whether the vehicle confirms what the charger says of the charging: a second source, for the evidence only.

Nothing is ever moved, stopped or powered because of it: the vehicle's protocol is only listened to, and not every
vehicle can be heard.
"""

from __future__ import annotations

import enum

from drivers.base import CarPhase, CarStatus, ChargerStatus


class Opinion(enum.Enum):
    """What the vehicle's own protocol makes of the charger's word."""

    NOBODY_LISTENS = "nobody listens to the vehicle"
    NOT_HEARD = "the vehicle is not heard"
    CONFIRMED = "the vehicle confirms it"
    CONTRADICTED = "the vehicle says otherwise"


def opinion(charger: ChargerStatus | None, car: CarStatus | None, least_current_a: float) -> Opinion:
    """Compare both sources; a charger that is silent counts as not charging. Pure."""
    if car is None:
        return Opinion.NOBODY_LISTENS
    if car.phase is CarPhase.SILENT:
        return Opinion.NOT_HEARD
    charging = charger is not None and charger.contactor_closed and charger.current_a >= least_current_a
    return Opinion.CONFIRMED if charging == (car.phase is CarPhase.CHARGING) else Opinion.CONTRADICTED


def in_words(said: Opinion, charger: ChargerStatus | None, car: CarStatus | None) -> str:
    """One line for log, recording and report."""
    first = "the charger is silent" if charger is None else f"the charger says {charger.current_a:.1f} A"
    if car is None or said is Opinion.NOT_HEARD:
        return f"{first}; {said.value}"
    why = f" ({car.reason})" if car.reason else ""
    return (
        f"{first}; {said.value}: {car.protocol} {car.phase.value}{why}, "
        f"{car.voltage_v:.0f} V, {car.current_a:.1f} A, {car.charge_percent:.0f} %"
    )
