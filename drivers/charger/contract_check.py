"""Does a supplier's DBC mean what the contract means? Units, value tables and ranges of the signals, by name.

Only names bind a file to the contract, so a signal of the right name in another unit would be believed: metres taken
for millimetres. What cannot be meant is named before anything is opened.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

UNITS = {
    **dict.fromkeys(("X", "Y", "Z", "RMSE", "Tolerance"), "mm"),
    **dict.fromkeys(("RX", "RY", "RZ"), "rad"),
    **dict.fromkeys(("Fitness", "SoC"), "%"),
    **{"Age": "ms", "Voltage": "V", "Current": "A", "TempDC": "degC"},
}
"""Spelled as in the bundled file; a file may leave a unit out."""
_SAME = {"°c": "degc", "c": "degc", "percent": "%", "volt": "v", "ampere": "a", "amp": "a"}

LARGEST = {
    **{"Mode": 15, "Flags": 0x1FF, "CycleId": 0xFFFF, "Cmd": 15, "CmdSeq": 255, "AckSeq": 255, "Arg": 255},
    **{"PosSeq": 15, "RotSeq": 15, "QualSeq": 15, "PoseSeq": 255, "Valid": 3, "Frame": 2, "Method": 2},
    **{"PlugLock": 4, "Prox": 4, "Pilot": 5, "AckResult": 5, "FaultCode": 265},
    **dict.fromkeys(("ContactorClosed", "DockEnable", "MotionInhibit", "EStop"), 1),
}
"""Raw numbers that have to fit: these signals are counted or looked up in a table, so they are not scaled."""
STATES = {"RC_Heartbeat": 15, "CH_Status": 11}
"""The same for ``State``."""

REACH = {
    **dict.fromkeys(("X", "Y", "Z"), (-1000.0, 1000.0)),
    **dict.fromkeys(("RX", "RY", "RZ"), (-3.15, 3.15)),
    **{"Current": (0.0, 50.0), "Voltage": (0.0, 450.0), "Fitness": (0.0, 100.0), "SoC": (0.0, 100.0)},
}
"""Least and largest value that has to fit, in the unit above: a docking pose in reach, a charger of modest power."""
FINEST = {
    **dict.fromkeys(("X", "Y", "Z"), 0.1),
    **dict.fromkeys(("RX", "RY", "RZ"), 0.001),
    "Current": 0.5,
}
"""Largest step: coarser ones would cost the pose its accuracy, or hide the current below which a plug may be pulled."""


def complaints(database: Any, wanted: dict[str, tuple[str, ...]], counters: int | None) -> list[str]:
    """What speaks against each wanted signal of a cantools database, in words; empty when nothing does.

    ``counters``: how many values each message's Counter takes; None without one.
    """
    found = []
    for message, names in wanted.items():
        signal = database.get_message_by_name(message).get_signal_by_name
        if counters is not None:
            found += [f"{message}.Counter {why}" for why in _against_number(signal("Counter"), counters - 1)]
        found += [f"{message}.{name} {why}" for name in names for why in _against(message, signal(name))]
    return found


def _against(message: str, signal: Any) -> Iterator[str]:
    unit = UNITS.get(signal.name)
    if unit and signal.unit and _plain(signal.unit) != _plain(unit):
        yield f"is in {signal.unit}, not in {unit}"
        return  # its numbers say nothing then
    largest = STATES.get(message) if signal.name == "State" else LARGEST.get(signal.name)
    if largest is not None:
        yield from _against_number(signal, largest)
    least, most = _range(signal)
    if signal.name in REACH and not (least <= REACH[signal.name][0] and most >= REACH[signal.name][1]):
        wanted = "{:g} to {:g}".format(*REACH[signal.name])
        yield f"reaches from {least:g} to {most:g} {unit}, at least {wanted} are needed"
    if abs(signal.scale) > FINEST.get(signal.name, float("inf")):
        yield f"has steps of {signal.scale:g} {unit}, larger than {FINEST[signal.name]:g}"


def _against_number(signal: Any, largest: int) -> Iterator[str]:
    if (signal.scale, signal.offset) != (1, 0):
        yield "is scaled, but is a plain number in the contract"
    elif _range(signal)[1] < largest:
        yield f"goes up to {_range(signal)[1]:g}, {largest} is needed"


def _range(signal: Any) -> tuple[float, float]:
    """What the bits can carry, cut to what the file allows."""
    bits = signal.length - 1 if signal.is_signed else signal.length
    ends = [(-(1 << bits) if signal.is_signed else 0), (1 << bits) - 1]
    least, most = sorted(raw * signal.scale + signal.offset for raw in ends)
    allowed = (signal.minimum, signal.maximum)
    if None not in allowed and allowed[0] < allowed[1]:  # [0|0] in a DBC means that nobody said
        least, most = max(least, allowed[0]), min(most, allowed[1])
    return least, most


def _plain(unit: str) -> str:
    folded = unit.strip().lower()
    return _SAME.get(folded, folded)
