"""The docking procedure's states, events and transitions: pure, exhaustive, printable (``portdock states``).

Every pair of state and event has exactly one answer. An event that means nothing in a state leaves the state as it is;
which pairs do so is part of the table, not an accident.
"""

from __future__ import annotations

import enum
from types import MappingProxyType


class State(enum.IntEnum):
    """What the controller is doing. The number is what the CAN heartbeat carries."""

    OFFLINE = 0
    SELF_CHECK = 1
    READY = 2
    STAGING = 3
    SCANNING = 4
    LOCATING = 5
    APPROACHING = 6
    INSERTING = 7
    VERIFYING = 8
    CHARGING = 9
    RELEASING = 10
    RETREATING = 11
    HOLD = 12
    FAULT = 15


class Event(enum.Enum):
    """What can happen. Names say what became true."""

    STARTED = "started"
    CHECKS_PASSED = "checks passed"
    CHARGING_FOUND = "charging found at start"
    DOCK_REQUESTED = "dock requested"
    UNDOCK_REQUESTED = "undock requested"
    AT_STAGING = "at staging"
    SCAN_COMPLETE = "scan complete"
    LOCATED = "located"
    NEXT_VIEWPOINT = "not located, next viewpoint"
    NOT_LOCATED = "not located, viewpoints used up"
    AT_PRE_CONTACT = "at pre-contact"
    SEATED = "seated"
    NOT_INSERTED = "not inserted"
    MATED = "mated"
    NOT_MATED = "not mated"
    CHARGE_COMPLETE = "charge complete"
    RELEASED = "released"
    RETREATED = "retreated"
    RETREATED_TO_RETRY = "retreated, next attempt"
    PAUSED = "paused"
    RESUMED = "resumed"
    RESET = "operator's reset"
    SHUT_DOWN = "shut down"
    # STOP: see STOPS; the others latch wherever there is power
    STOP = "stop requested"
    ABORT = "abort requested"
    ESTOP = "emergency stop"
    PROTECTIVE_STOP = "protective stop"
    LINK_LOST = "link lost"
    CHARGER_FAULT = "charger fault"
    DEADLINE = "deadline passed"
    FAILED = "check failed"


_S, _E = State, Event

LATCHING = frozenset({_E.ABORT, _E.ESTOP, _E.PROTECTIVE_STOP, _E.LINK_LOST, _E.CHARGER_FAULT, _E.DEADLINE, _E.FAILED})
"""Events that lead from every powered state to FAULT, where only an operator's reset leads out."""

PROCEDURE: dict[tuple[State, Event], State] = {
    (_S.OFFLINE, _E.STARTED): _S.SELF_CHECK,
    (_S.SELF_CHECK, _E.CHECKS_PASSED): _S.READY,
    (_S.SELF_CHECK, _E.CHARGING_FOUND): _S.CHARGING,
    (_S.SELF_CHECK, _E.UNDOCK_REQUESTED): _S.RELEASING,
    (_S.READY, _E.DOCK_REQUESTED): _S.STAGING,
    (_S.READY, _E.UNDOCK_REQUESTED): _S.RETREATING,
    (_S.STAGING, _E.AT_STAGING): _S.SCANNING,
    (_S.SCANNING, _E.SCAN_COMPLETE): _S.LOCATING,
    (_S.LOCATING, _E.LOCATED): _S.APPROACHING,
    (_S.LOCATING, _E.NEXT_VIEWPOINT): _S.STAGING,
    (_S.LOCATING, _E.NOT_LOCATED): _S.READY,
    (_S.APPROACHING, _E.AT_PRE_CONTACT): _S.INSERTING,
    (_S.INSERTING, _E.SEATED): _S.VERIFYING,
    (_S.INSERTING, _E.NOT_INSERTED): _S.RETREATING,
    (_S.VERIFYING, _E.MATED): _S.CHARGING,
    (_S.VERIFYING, _E.NOT_MATED): _S.RETREATING,
    (_S.CHARGING, _E.CHARGE_COMPLETE): _S.RELEASING,
    (_S.CHARGING, _E.UNDOCK_REQUESTED): _S.RELEASING,
    (_S.RELEASING, _E.RELEASED): _S.RETREATING,
    (_S.RETREATING, _E.RETREATED): _S.READY,
    (_S.RETREATING, _E.RETREATED_TO_RETRY): _S.STAGING,
    (_S.HOLD, _E.RESUMED): _S.STAGING,
    (_S.FAULT, _E.RESET): _S.SELF_CHECK,
}
"""The docking procedure itself."""

PAUSES: dict[tuple[State, Event], State] = {
    (state, _E.PAUSED): _S.HOLD for state in (_S.STAGING, _S.SCANNING, _S.LOCATING, _S.APPROACHING)
}
"""A recoverable pause exists before contact only."""

STOPS: dict[tuple[State, Event], State] = {
    (_S.STAGING, _E.STOP): _S.READY,
    (_S.SCANNING, _E.STOP): _S.READY,
    (_S.LOCATING, _E.STOP): _S.READY,
    (_S.HOLD, _E.STOP): _S.READY,
    (_S.APPROACHING, _E.STOP): _S.RETREATING,
    (_S.INSERTING, _E.STOP): _S.RETREATING,
    (_S.VERIFYING, _E.STOP): _S.RELEASING,
    (_S.CHARGING, _E.STOP): _S.RELEASING,
}
"""A stop finishes safely: from contact on that means out along the inserted axis, power and lock first."""

SHUT_DOWNS: dict[tuple[State, Event], State] = {
    (state, _E.SHUT_DOWN): _S.OFFLINE for state in (_S.SELF_CHECK, _S.READY, _S.CHARGING, _S.FAULT)
}
"""Where the process may end. From CHARGING: power is stopped, the plug stays locked, nothing moves."""

LATCHES: dict[tuple[State, Event], State] = {
    (state, event): _S.FAULT for state in State if state is not _S.OFFLINE for event in LATCHING
}

TRANSITIONS: MappingProxyType[tuple[State, Event], State] = MappingProxyType(
    PROCEDURE | PAUSES | STOPS | SHUT_DOWNS | LATCHES
)
"""(state, event) -> next state. A pair that is not listed leaves the state unchanged."""

RESTING = frozenset({_S.OFFLINE, _S.READY, _S.FAULT})
"""Nothing is under way in these; every other state has a deadline (``deadlines`` in the configuration)."""

IN_CONTACT = frozenset({_S.INSERTING, _S.VERIFYING, _S.CHARGING, _S.RELEASING, _S.RETREATING})
"""States in which the plug may be in the port."""


def next_state(state: State, event: Event) -> State:
    """The state that follows; the same state for an event that means nothing there."""
    return TRANSITIONS.get((state, event), state)


def as_markdown() -> str:
    """The table as Markdown, one row for each state, the latching events in a sentence below it."""
    rows = ["| state | event | next |", "|---|---|---|"]
    for (state, event), target in TRANSITIONS.items():
        if event not in LATCHING:
            rows.append(f"| {state.name} | {event.value} | {target.name} |")
    latching = ", ".join(event.value for event in Event if event in LATCHING)
    rows += ["", f"In every state but OFFLINE: {latching} -> FAULT, latched until an operator's reset."]
    return "\n".join(rows)


def as_dot() -> str:
    """The same as a Graphviz graph; edges into FAULT are drawn once."""
    edges: dict[tuple[State, State], list[str]] = {}
    for (state, event), target in TRANSITIONS.items():
        if event not in LATCHING:
            edges.setdefault((state, target), []).append(event.value)
    lines = ["digraph portdock {", "  rankdir=LR; node [shape=box, style=rounded];"]
    for (state, target), events in edges.items():
        label = r"\n".join(events)
        lines.append(f'  {state.name} -> {target.name} [label="{label}"];')
    lines += ['  ANY [label="any state", shape=plaintext];', '  ANY -> FAULT [label="latching events"];', "}"]
    return "\n".join(lines)
