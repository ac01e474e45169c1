"""Faults and levers of the mock charger: one JSON object for each line of standard input, as ``{"estop": true}``.

silent            no frames at all                     damaged      every checksum wrong
stuck_counter     counters stand still                 frozen       repeats its last frames byte for byte
deaf              hears no robot                       mute         never acknowledges
estop             emergency stop pressed               plugged      the plug sits in the port (only without a world)
lock_jammed       the lock stops halfway               contactor_welded
release_pressed   the release button of the latch      precharge_fails  the voltage does not rise
reject            name of the request to refuse once   paused       current held at zero
temperature_c     the contact is this hot              ventilation  pilot state D instead of C
garbage           so many random bytes to the host     unplug_adapter  true: the tty vanishes, false: it is back
twin              a second node sends the same ids     reboot       true: start afresh
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any


@dataclass(slots=True)
class Lines:
    """What is wrong between the node and the bus at the moment."""

    silent: bool = False
    damaged: bool = False
    stuck_counter: bool = False
    frozen: bool = False
    deaf: bool = False
    mute: bool = False
    twin: bool = False


LEVERS = (
    *("estop", "plugged", "lock_jammed", "contactor_welded", "reject", "paused", "temperature_c", "ventilation"),
    *("release_pressed", "precharge_fails"),
    *("garbage", "unplug_adapter", "reboot"),
)


def parse(line: str) -> dict[str, Any]:
    """The controls of one line. Raises ValueError that names what is not known."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"not JSON: {error}") from None
    if not isinstance(values, dict):
        raise ValueError("a control line is one JSON object")
    unknown = set(values) - set(LEVERS) - set(Lines.__dataclass_fields__)
    if unknown:
        raise ValueError(f"unknown control: {', '.join(sorted(unknown))}")
    return values
